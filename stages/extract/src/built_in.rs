//! The built-in Mars as an archive.

use std::collections::BTreeSet;

use marf_stage::{Ctx, Listing, ParamError, Shard, StageError};

use crate::archive::{ArchiveFile, ArchiveFiles};
use crate::params::DemoArchive;
use crate::sols::Sols;
use marf_demo::{Demo, DemoError, DemoOptions, SOLS};

/// The demo with the sols asked for.
pub(crate) struct BuiltIn {
    demo: Demo,
    sols: BTreeSet<u32>,
}

impl BuiltIn {
    /// Checks the options; draws nothing.
    pub fn new(archive: &DemoArchive) -> Result<Self, ParamError> {
        let refuse = |message: String| ParamError::new("archive.sols", message);
        let chosen = Sols::parse(&archive.sols).map_err(refuse)?;
        if chosen == Sols::Latest {
            return Err(refuse(
                "the demo has no latest sol; write a range, e.g. \"1..=3\"".to_owned(),
            ));
        }
        let sols = chosen.choose(&SOLS.collect());
        if sols.is_empty() {
            return Err(refuse(format!(
                "the demo has sols {} to {}",
                SOLS.start(),
                SOLS.end()
            )));
        }
        let (width_px, height_px) = (archive.width, archive.width / 4 * 3);
        let demo = Demo::new(DemoOptions {
            width_px,
            height_px,
            seed: archive.seed,
        })
        .map_err(|error| ParamError::new("archive.width", error.to_string()))?;
        Ok(Self { demo, sols })
    }
}

impl ArchiveFiles for BuiltIn {
    fn list(&self, _ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let shard = |sol: &u32| {
            let fingerprint = self.demo.fingerprint(*sol).map_err(refused)?;
            Ok(Shard {
                shard: *sol,
                fingerprint,
            })
        };
        let shards = self.sols.iter().map(shard).collect::<Result<_, StageError>>()?;
        Ok(Listing {
            shards,
            ..Listing::default()
        })
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Vec<ArchiveFile>, StageError> {
        let progress = |done: u64, total: u64| ctx.progress.at(done, total, &format!("sol {shard}"));
        let files = self
            .demo
            .files(shard, &progress, &|| ctx.cancel.is_set())
            .map_err(refused)?;
        Ok(files
            .into_iter()
            .map(|file| ArchiveFile::in_memory(file.name, file.bytes))
            .collect())
    }
}

fn refused(error: DemoError) -> StageError {
    match error {
        DemoError::Cancelled => StageError::Cancelled,
        other => StageError::new(other.to_string()),
    }
}
