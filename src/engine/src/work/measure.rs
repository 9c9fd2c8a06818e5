//! Measures of rows, kept in one table a shard.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use marf_cache::{Digest, manifest::Row};
use marf_stage::{Measure, Measured, StageError};
use parking_lot::Mutex;
use rayon::prelude::*;

use super::stage_run::StageRun;
use crate::{
    errors::{contract_violation, store_error},
    items::ShardRows,
    measure_table::{MeasureTable, row_digest},
};

/// New measures are stored at this interval, so a kill loses no more than this.
const FLUSH_INTERVAL: Duration = Duration::from_secs(2);

/// The measures of all rows of some shards, in their order.
pub(super) struct Measures {
    values: Vec<Vec<Arc<[u8]>>>,
    /// Number of rows that no earlier run had measured.
    pub(super) measured: u64,
}

/// The tables of the shards, with what is new in them.
struct Tables<'a> {
    run: &'a StageRun<'a>,
    by_shard: BTreeMap<u32, Table>,
    done: u64,
    flushed: Instant,
}

/// The table of one shard.
struct Table {
    key: Digest,
    measures: MeasureTable,
    is_new: bool,
}

/// Measures the rows that are in no table yet, and returns the measures of all.
pub(super) fn measure(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    shards: &[ShardRows],
) -> Result<Measures, StageError> {
    let mut tables = Tables::load(run, stage, shards)?;
    let digests: Vec<Vec<Digest>> = shards
        .par_iter()
        .map(|part| part.rows.iter().map(row_digest).collect())
        .collect();
    let pairs = shards.iter().zip(&digests);
    let rows = pairs.flat_map(|(part, digests)| {
        part.rows
            .iter()
            .zip(digests)
            .map(move |(row, digest)| (part.shard, row, *digest))
    });
    let missing: Vec<(u32, &Row, Digest)> = rows
        .filter(|(shard, _, digest)| !tables.knows(*shard, digest))
        .collect();
    let total = missing.len() as u64;
    tables.flushed = Instant::now();
    let shared = Mutex::new(tables);
    let outcome = missing.par_iter().try_for_each(|(shard, row, digest)| {
        run.ctx.check()?;
        let measure = stage.measure(&run.ctx, row)?;
        let mut tables = shared.lock();
        tables.add(*shard, *digest, measure, total)
    });
    let mut tables = shared.into_inner();
    // New measures are stored also after a failure or a cancellation.
    tables.flush()?;
    outcome?;
    tables.collect(shards, &digests, total)
}

impl<'a> Tables<'a> {
    /// Reads the tables of all shards.
    fn load(run: &'a StageRun<'a>, stage: &dyn Measure, shards: &[ShardRows]) -> Result<Self, StageError> {
        let mut by_shard = BTreeMap::new();
        for part in shards {
            let key = run.table_key(stage, part.shard);
            let blob = run.store.memo(&key).map_err(store_error)?;
            // A missing or damaged table is an empty one.
            let bytes = blob.and_then(|blob| run.store.get(&blob).ok());
            let measures = bytes
                .and_then(|bytes| MeasureTable::decode(&bytes))
                .unwrap_or_default();
            let is_new = false;
            by_shard.insert(
                part.shard,
                Table {
                    key,
                    measures,
                    is_new,
                },
            );
        }
        Ok(Self {
            run,
            by_shard,
            done: 0,
            flushed: Instant::now(),
        })
    }

    fn get(&self, shard: u32, digest: &Digest) -> Option<&Arc<[u8]>> {
        self.by_shard.get(&shard)?.measures.0.get(digest)
    }

    fn knows(&self, shard: u32, digest: &Digest) -> bool {
        self.get(shard, digest).is_some()
    }

    /// Adds the measure of a row; stores the tables if that is due.
    fn add(&mut self, shard: u32, digest: Digest, measure: Vec<u8>, total: u64) -> Result<(), StageError> {
        if let Some(table) = self.by_shard.get_mut(&shard) {
            table.measures.0.insert(digest, Arc::from(measure));
            table.is_new = true;
        }
        self.done += 1;
        self.run.ctx.progress.at(self.done, total, "");
        match self.flushed.elapsed() >= FLUSH_INTERVAL {
            true => self.flush(),
            false => Ok(()),
        }
    }

    /// Stores the tables that have new measures, durably.
    fn flush(&mut self) -> Result<(), StageError> {
        self.flushed = Instant::now();
        let mut any = false;
        for table in self.by_shard.values_mut().filter(|table| table.is_new) {
            let blob = self.run.ctx.put(&table.measures.encode())?;
            self.run.store.put_memo(table.key, blob);
            table.is_new = false;
            any = true;
        }
        match any {
            true => self.run.store.commit().map_err(store_error),
            false => Ok(()),
        }
    }

    /// Returns the measures of all rows.
    fn collect(
        self,
        shards: &[ShardRows],
        digests: &[Vec<Digest>],
        measured: u64,
    ) -> Result<Measures, StageError> {
        let of_part = |(part, digests): (&ShardRows, &Vec<Digest>)| {
            let values = digests.iter().map(|digest| self.get(part.shard, digest).cloned());
            values.collect::<Option<Vec<_>>>()
        };
        let values: Option<Vec<Vec<_>>> = shards.iter().zip(digests).map(of_part).collect();
        let values = values.ok_or_else(|| contract_violation("a measure got lost".to_owned()))?;
        Ok(Measures { values, measured })
    }
}

impl Measures {
    /// Returns the rows of one shard with their measures.
    pub(super) fn items<'a>(&'a self, shards: &'a [ShardRows], index: usize) -> Vec<Measured<'a>> {
        let part = &shards[index];
        let items = part.rows.iter().zip(&self.values[index]);
        items
            .map(|(row, measure)| Measured {
                shard: part.shard,
                row,
                measure,
            })
            .collect()
    }
}
