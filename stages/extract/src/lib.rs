//! Archives to photos and labels.
//!
//! Names, labels and pixels of three missions are read into photos that every later stage can decode, with the
//! label's camera as a prior. Invariant: nothing an archive holds stops the stage: a file that cannot be used
//! becomes a verdict with its reason, and no file is left out in silence.
//!
//! ```text
//! kinds/    the table of kinds of archives: one file and one row a kind
//! archive/  declaration and context of a kind, files by shard
//! remote/   common to archives on servers: catalogs, marf.lock, downloads
//! net/      the HTTP client
//! check/    whether an archive on a server is still as the readers expect, asked through checked.rs
//! recorded.rs  an archive as an earlier run recorded it
//! fetch.rs  from the files of a shard to rows, verdicts and measures of the filters
//! ```

mod archive;
mod check;
mod checked;
mod fetch;
mod files;
pub mod fuzzing;
mod kinds;
mod net;
mod params;
mod products;
mod recorded;
mod remote;
mod stat;

use marf_stage::{
    ArchiveContext, Ctx, Define, Fetched, Files, Listing, ParamError, Port, Source, Stage, StageError, Table,
    Threads, Work,
};

pub use archive::check::{Check, CheckState};
pub use archive::kind::ArchiveDef;
pub use checked::CheckedArchive;
pub use kinds::ARCHIVES;
pub use params::{ArchiveTable, ExtractParams};
pub use remote::{PinnedProduct, UnreadableLock, pinned_products};

/// Brings photos in from an archive.
///
/// Outputs `photos`, `verdicts` and `companions`. The rows of `photos` are [`marf_scene::PhotoFacts`]. Blob `image`
/// is the one that every later stage decodes, `raw` has the original bytes where they differ, `label` those of the
/// label, and `thumbnail` a small JPEG of an image of 64 KiB and more. The measures of filters that
/// [`ArchiveContext::measures`] names are made from the decode that checks the photo. They change no row.
pub struct Extract {
    archive: Box<dyn archive::ArchiveFiles>,
    reading: Reading,
    /// The tables of the filters that are filled.
    measures: Vec<Table>,
}

/// The parameters that enter the key. The archive's do not: their effect is in the fingerprints of its shards.
#[derive(serde::Serialize)]
struct Reading {
    white_radiance: f64,
    max_decoded_mb: u64,
}

impl Stage for Extract {
    fn params(&self) -> serde_json::Value {
        marf_stage::key_params(&self.reading, &[])
    }

    fn work(&self) -> Work<'_> {
        Work::Source(self)
    }

    fn threads(&self) -> Threads {
        Threads::All
    }
}

impl Source for Extract {
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        self.archive.list(ctx)
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Option<Files>, StageError> {
        self.archive.digests(ctx, shard)
    }

    fn fetch(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError> {
        if let Some(files) = self.archive.digests(ctx, shard)? {
            ctx.put(&files.encode())?;
        }
        let shard_files = self.archive.files(ctx, shard)?;
        let limit_bytes = self.reading.max_decoded_mb.saturating_mul(1_000_000);
        let fetched = fetch::fetch(ctx, &shard_files.files, shard, &self.measures, limit_bytes)?;
        Ok(Fetched {
            fingerprint: shard_files.fingerprint,
            warnings: shard_files.warnings,
            ..fetched
        })
    }
}

impl Define for Extract {
    type Params = ExtractParams;
    const NAME: &'static str = "extract";
    const ABOUT: &'static str = "archives to photos with what their labels say of camera and place";
    const VERSION: u32 = 9;
    const PORTS: &'static [Port] = &[];
    const OUTPUTS: &'static [&'static str] =
        &[marf_stage::PHOTOS, marf_stage::VERDICTS, marf_stage::COMPANIONS];

    fn new(params: ExtractParams) -> Result<Self, ParamError> {
        Self::with_archive(params, ArchiveContext::default())
    }

    fn with_archive(params: ExtractParams, context: ArchiveContext) -> Result<Self, ParamError> {
        let of_archive = |error: ParamError| {
            let path = format!("archive.{}", error.path);
            ParamError::new(path.trim_end_matches('.'), error.message)
        };
        let mut measures = marf_filter::tables();
        measures.retain(|table| context.measures.contains(table));
        let archive: Box<dyn archive::ArchiveFiles> = match context.recorded {
            Some(recorded) => Box::new(recorded::Recorded(recorded)),
            None => params.archive.open(context).map_err(of_archive)?,
        };
        Ok(Self {
            archive,
            reading: Reading {
                white_radiance: marf_pds::WHITE_RADIANCE,
                max_decoded_mb: params.max_decoded_mb,
            },
            measures,
        })
    }
}
