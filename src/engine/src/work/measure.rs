//! Measures of items, kept by row in one table a shard.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use marf_cache::{Digest, manifest::Row};
use marf_stage::{Measure, Measured, StageError};
use parking_lot::Mutex;
use rayon::prelude::*;

use super::{Job, store_error};
use crate::{
    memo::{MemoTable, row_digest},
    photos::Part,
};

/// What was measured is kept this often, so a kill costs no more than this.
const FLUSH_EVERY: Duration = Duration::from_secs(2);

/// The measure of every row of some parts, in their order.
pub(super) struct Measures {
    values: Vec<Vec<Arc<[u8]>>>,
    /// How many were not known before.
    pub(super) measured: u64,
}

/// The tables of the shards at hand, and what is new in them.
struct Tables<'a> {
    job: &'a Job<'a>,
    by_shard: BTreeMap<u32, Table>,
    done: u64,
    flushed: Instant,
}

struct Table {
    key: Digest,
    memo: MemoTable,
    is_new: bool,
}

/// Measures the rows that no run has measured yet, and returns the measures of all.
pub(super) fn measure(job: &Job<'_>, stage: &dyn Measure, parts: &[Part]) -> Result<Measures, StageError> {
    let mut tables = Tables::load(job, stage, parts)?;
    let digests: Vec<Vec<Digest>> = parts
        .par_iter()
        .map(|part| part.rows.iter().map(row_digest).collect())
        .collect();
    let pairs = parts.iter().zip(&digests);
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
        job.ctx.check()?;
        let measure = stage.measure(&job.ctx, row)?;
        let mut tables = shared.lock();
        tables.add(*shard, *digest, measure, total)
    });
    let mut tables = shared.into_inner();
    // Also after a failure or a wish to stop: what was measured stays.
    tables.flush()?;
    outcome?;
    tables.collect(parts, &digests, total)
}

impl<'a> Tables<'a> {
    fn load(job: &'a Job<'a>, stage: &dyn Measure, parts: &[Part]) -> Result<Self, StageError> {
        let mut by_shard = BTreeMap::new();
        for part in parts {
            let key = job.table_key(stage, part.shard);
            let blob = job.store.memo(&key).map_err(store_error)?;
            // A table that is gone or damaged is an empty one.
            let bytes = blob.and_then(|blob| job.store.get(&blob).ok());
            let memo = bytes
                .and_then(|bytes| MemoTable::decode(&bytes))
                .unwrap_or_default();
            let is_new = false;
            by_shard.insert(part.shard, Table { key, memo, is_new });
        }
        Ok(Self {
            job,
            by_shard,
            done: 0,
            flushed: Instant::now(),
        })
    }

    fn get(&self, shard: u32, digest: &Digest) -> Option<&Arc<[u8]>> {
        self.by_shard.get(&shard)?.memo.0.get(digest)
    }

    fn knows(&self, shard: u32, digest: &Digest) -> bool {
        self.get(shard, digest).is_some()
    }

    fn add(&mut self, shard: u32, digest: Digest, measure: Vec<u8>, total: u64) -> Result<(), StageError> {
        if let Some(table) = self.by_shard.get_mut(&shard) {
            table.memo.0.insert(digest, Arc::from(measure));
            table.is_new = true;
        }
        self.done += 1;
        self.job.ctx.progress.at(self.done, total, "");
        match self.flushed.elapsed() >= FLUSH_EVERY {
            true => self.flush(),
            false => Ok(()),
        }
    }

    fn flush(&mut self) -> Result<(), StageError> {
        self.flushed = Instant::now();
        let mut any = false;
        for table in self.by_shard.values_mut().filter(|table| table.is_new) {
            let blob = self.job.ctx.put(&table.memo.encode())?;
            self.job.store.put_memo(table.key, blob);
            table.is_new = false;
            any = true;
        }
        match any {
            true => self.job.store.commit().map_err(store_error),
            false => Ok(()),
        }
    }

    fn collect(self, parts: &[Part], digests: &[Vec<Digest>], measured: u64) -> Result<Measures, StageError> {
        let of_part = |(part, digests): (&Part, &Vec<Digest>)| {
            let values = digests.iter().map(|digest| self.get(part.shard, digest).cloned());
            values.collect::<Option<Vec<_>>>()
        };
        let values: Option<Vec<Vec<_>>> = parts.iter().zip(digests).map(of_part).collect();
        let values = values.ok_or_else(|| crate::photos::bug("a measure got lost".to_owned()))?;
        Ok(Measures { values, measured })
    }
}

impl Measures {
    /// Returns the items of one part with their measures.
    pub(super) fn items<'a>(&'a self, parts: &'a [Part], index: usize) -> Vec<Measured<'a>> {
        let part = &parts[index];
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
