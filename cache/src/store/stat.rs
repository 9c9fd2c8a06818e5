//! Sizes of a store.

use std::collections::{BTreeMap, HashSet};

use serde::Serialize;

use super::{Store, StoreError, StoreStat, files::Place, pack::Kind};

/// Totals of the records of a stage.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct StageStat {
    /// Records of the stage.
    pub records: u64,
    /// Different outputs of theirs.
    pub outputs: u64,
    /// Bytes of these outputs. An output of several stages counts for the first by name.
    pub bytes: u64,
}

impl Store {
    /// Counts what is committed.
    ///
    /// # Errors
    /// A folder or an index that cannot be read.
    pub fn stat(&self) -> Result<StoreStat, StoreError> {
        let objects = &self.objects;
        let mut stat = StoreStat {
            packs: objects.index.listed()?.len() as u64,
            runs: self.run_numbers()?.len() as u64,
            index_bytes: objects.index.bytes(),
            quarantined: objects.files.names(&self.dir.join("bad"))?.len() as u64,
            ..StoreStat::default()
        };
        objects.for_each_loose(|_, meta| match meta.place {
            Place::Here => {
                stat.loose_blobs += 1;
                stat.loose_bytes += meta.bytes;
            }
            Place::Outside => {
                stat.references += 1;
                stat.referenced_bytes += meta.bytes;
            }
        })?;
        objects.index.for_each(|row| match row.kind {
            Kind::Blob => {
                stat.packed_blobs += 1;
                stat.packed_bytes += u64::from(row.len);
            }
            Kind::Record => stat.records += 1,
            Kind::Memo => stat.memos += 1,
        })?;
        Ok(stat)
    }

    /// Counts records and outputs by stage. Reads every record.
    ///
    /// # Errors
    /// As [`Store::record`].
    pub fn stat_by_stage(&self) -> Result<BTreeMap<String, StageStat>, StoreError> {
        let mut records = self.records()?;
        records.sort_by(|a, b| (&a.stage, a.key).cmp(&(&b.stage, b.key)));
        let mut seen = HashSet::new();
        let mut stats: BTreeMap<String, StageStat> = BTreeMap::new();
        for record in records {
            let stat = stats.entry(record.stage).or_default();
            stat.records += 1;
            for output in record
                .outputs
                .values()
                .filter(|output| seen.insert(output.digest))
            {
                stat.outputs += 1;
                stat.bytes += output.bytes;
            }
        }
        Ok(stats)
    }
}
