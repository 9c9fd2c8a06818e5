//! An archive as an earlier run met it: every file by its digest, from the store.

use marf_stage::{Ctx, Listing, Origin, RecordedArchive, StageError};

use crate::archive::{ArchiveFile, ArchiveFiles, ShardFiles};

/// What an earlier run met, read again without looking at the archive.
pub(crate) struct Recorded(pub RecordedArchive);

impl ArchiveFiles for Recorded {
    fn list(&self, _ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        Ok(Listing {
            shards: self.0.shards.iter().map(|(shard, _)| shard.clone()).collect(),
            companions: self.0.companions.clone(),
            ..Listing::default()
        })
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<ShardFiles, StageError> {
        let recorded = self.0.shards.iter().find(|(listed, _)| listed.shard == shard);
        let (_, list) = recorded.ok_or_else(|| StageError::new(format!("sol {shard} was not recorded")))?;
        let origins = Origin::decode(&ctx.get(list)?).map_err(|error| {
            StageError::new(format!("the files of sol {shard} cannot be read")).cause(error.to_string())
        })?;
        Ok(ShardFiles {
            files: origins.into_iter().map(ArchiveFile::recorded).collect(),
            ..ShardFiles::default()
        })
    }
}
