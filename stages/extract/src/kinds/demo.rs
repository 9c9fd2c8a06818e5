//! The built-in Mars as an archive.

use std::collections::BTreeSet;

use marf_demo::{DemoError, DemoOptions, SOLS};
use marf_stage::{Ctx, Listing, ParamError, Shard, StageError};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::archive::access::{Local, LocalContext};
use crate::archive::kind::ArchiveKind;
use crate::archive::{ArchiveFile, ArchiveFiles, ShardFiles};
use marf_stage::Sols;

/// The keys of `kind = "demo"`.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct DemoParams {
    /// Sols: `1..=5`, `3` or `1,4,7..=9`.
    sols: Sols,
    /// Seed of the terrain.
    seed: u64,
    /// Width of a photo, pixels.
    width: u32,
    /// Sol from which its site is changed: a stone is added, and dust is gone from a strip.
    change: Option<u32>,
}

impl Default for DemoParams {
    fn default() -> Self {
        Self {
            sols: Sols::Ranges(vec![(1, 2)]),
            seed: 1,
            width: 640,
            change: None,
        }
    }
}

/// The built-in Mars and the sols asked for.
pub(crate) struct Demo {
    demo: marf_demo::Demo,
    sols: BTreeSet<u32>,
}

impl ArchiveKind for Demo {
    type Params = DemoParams;
    type Location = Local;
    const KIND: &'static str = "demo";
    const ABOUT: &'static str = "the built-in Mars: a procedural landscape, rendered on this machine";

    fn open(params: DemoParams, _context: LocalContext) -> Result<Box<dyn ArchiveFiles>, ParamError> {
        let refuse = |message: String| ParamError::new("sols", message);
        if params.sols == Sols::Latest {
            return Err(refuse(
                "the demo has no latest sol: write a range, e.g. \"1..=3\"".to_owned(),
            ));
        }
        let sols = params.sols.choose(&SOLS.collect());
        if sols.is_empty() {
            return Err(refuse(format!(
                "the demo has sols {} to {}",
                SOLS.start(),
                SOLS.end()
            )));
        }
        let (width_px, height_px) = (params.width, params.width / 4 * 3);
        let mut demo = marf_demo::Demo::new(DemoOptions {
            width_px,
            height_px,
            seed: params.seed,
        })
        .map_err(|error| ParamError::new("width", error.to_string()))?;
        if let Some(sol) = params.change {
            let refuse = |error: DemoError| ParamError::new("change", error.to_string());
            demo = demo.with_change(sol).map_err(refuse)?;
        }
        Ok(Box::new(Self { demo, sols }))
    }
}

impl ArchiveFiles for Demo {
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

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<ShardFiles, StageError> {
        let progress = |done: u64, total: u64| ctx.progress.at(done, total, &format!("sol {shard}"));
        let files = self
            .demo
            .files(shard, &progress, &|| ctx.cancel.is_set())
            .map_err(refused)?;
        let files = files
            .into_iter()
            .map(|file| ArchiveFile::in_memory(file.name, file.bytes));
        Ok(ShardFiles {
            files: files.collect(),
            ..ShardFiles::default()
        })
    }
}

fn refused(error: DemoError) -> StageError {
    match error {
        DemoError::Cancelled => StageError::Cancelled,
        other => StageError::new(other.to_string()),
    }
}
