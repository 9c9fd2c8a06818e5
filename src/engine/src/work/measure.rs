//! Measures of rows, kept in one table a kind and shard.

use std::{
    collections::{BTreeMap, BTreeSet, btree_map::Entry},
    sync::Arc,
    time::{Duration, Instant},
};

use marf_cache::{Digest, Store, manifest::Row};
use marf_stage::{Measure, Measured, Progress, StageError, Table};
use parking_lot::Mutex;
use rayon::prelude::*;

use super::stage_run::StageRun;
use crate::{
    errors::{contract_violation, store_error},
    items::{ShardLeaves, ShardRows, read_shard},
    measure_table::{MeasureTable, row_digest, table_key},
    stage_io::StoreBlobs,
};

/// New measures are stored at this interval, so a kill loses no more than this.
const FLUSH_INTERVAL: Duration = Duration::from_secs(5);
/// Rows that are in memory at once: enough that all threads have work while a window ends.
const WINDOW_ROWS: u64 = 2_000;

/// Splits shards into runs of about [`WINDOW_ROWS`] rows, at least one shard each.
pub(super) fn windows<T>(shards: &[T], rows: impl Fn(&T) -> u64) -> Vec<&[T]> {
    let mut windows = Vec::new();
    let (mut first, mut held) = (0, 0);
    for (index, shard) in shards.iter().enumerate() {
        held += rows(shard);
        if held >= WINDOW_ROWS {
            windows.push(&shards[first..=index]);
            (first, held) = (index + 1, 0);
        }
    }
    windows.extend((first < shards.len()).then(|| &shards[first..]));
    windows
}

/// The rows of one shard, each with its measure.
pub(super) struct MeasuredShard {
    pub(super) rows: ShardRows,
    values: Vec<Arc<[u8]>>,
}

/// Some shards with their measures, in the order of the request.
pub(super) struct MeasuredShards {
    pub(super) shards: Vec<MeasuredShard>,
    /// Number of rows that no earlier run had measured.
    pub(super) measured: u64,
}

/// How many of the rows of a node are ready.
pub(super) struct RowProgress<'a> {
    progress: &'a dyn Progress,
    done: u64,
    total: u64,
}

impl<'a> RowProgress<'a> {
    pub(super) fn new(run: &StageRun<'a>, total: u64) -> Self {
        Self {
            progress: run.ctx.progress,
            done: 0,
            total,
        }
    }

    /// Returns whether all rows are ready.
    pub(super) fn is_complete(&self) -> bool {
        self.done >= self.total
    }

    fn add(&mut self, rows: u64) {
        self.done += rows;
        self.progress.at(self.done, self.total, "");
    }
}

impl MeasuredShard {
    /// Returns the rows with their measures.
    pub(super) fn items(&self) -> Vec<Measured<'_>> {
        let items = self.rows.rows.iter().zip(&self.values);
        items
            .map(|(row, measure)| Measured {
                shard: self.rows.shard,
                row,
                measure,
            })
            .collect()
    }
}

impl MeasuredShards {
    /// Returns the number of rows.
    fn rows(&self) -> u64 {
        self.shards.iter().map(|shard| shard.values.len() as u64).sum()
    }
}

/// Reads the rows of some shards and measures those that are not in the table of the stage yet.
pub(super) fn measure(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    shards: &[&ShardLeaves],
    progress: &mut RowProgress<'_>,
) -> Result<MeasuredShards, StageError> {
    let rows: Vec<ShardRows> = shards
        .par_iter()
        .map(|shard| read_shard(&run.ctx, shard))
        .collect::<Result<_, _>>()?;
    let Some(own) = stage.table() else {
        let unmeasured = without_measures(rows);
        progress.done += unmeasured.rows();
        return Ok(unmeasured);
    };
    let mut read: Vec<ShardTables> = rows
        .into_par_iter()
        .map(|rows| ShardTables::load(run, stage, own, rows))
        .collect::<Result<_, _>>()?;
    let missing: Vec<MissingRow> = (0..)
        .zip(&read)
        .flat_map(|(shard, tables)| {
            tables.missing.iter().map(move |&row| MissingRow {
                shard,
                row,
                tables: tables.wanted(row, own),
            })
        })
        .collect();
    let known = read
        .iter()
        .map(|shard| (shard.rows.rows.len() - shard.missing.len()) as u64);
    progress.add(known.sum());
    measure_missing(run, stage, &mut read, &missing, progress)?;
    let measured = missing.len() as u64;
    let shards: Result<Vec<_>, _> = read.into_iter().map(|shard| shard.finish(own)).collect();
    Ok(MeasuredShards {
        shards: shards?,
        measured,
    })
}

/// Returns the rows of shards for a stage that needs no measure.
fn without_measures(rows: Vec<ShardRows>) -> MeasuredShards {
    let nothing: Arc<[u8]> = Arc::from([]);
    let unmeasured = |rows: ShardRows| MeasuredShard {
        values: vec![Arc::clone(&nothing); rows.rows.len()],
        rows,
    };
    MeasuredShards {
        shards: rows.into_iter().map(unmeasured).collect(),
        measured: 0,
    }
}

/// A row without a measure: the place of its shard, its index there, and the tables that lack it.
struct MissingRow {
    shard: usize,
    row: usize,
    tables: Vec<Table>,
}

/// Measures rows and adds the results to the tables of their shards.
fn measure_missing(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    read: &mut [ShardTables],
    missing: &[MissingRow],
    progress: &mut RowProgress<'_>,
) -> Result<(), StageError> {
    let (views, shards): (Vec<_>, Vec<_>) = read.iter_mut().map(ShardTables::split).unzip();
    let new = Mutex::new(NewMeasures {
        run,
        shards,
        progress,
        flushed: Instant::now(),
    });
    // Blobs that a measure stores are named in the measure, not in the record of this node.
    let blobs = StoreBlobs::new(run.store);
    let ctx = run.with_blobs(&blobs);
    let outcome = missing.par_iter().try_for_each(|missing| {
        ctx.check()?;
        let view = &views[missing.shard];
        let values = stage.measure(&ctx, &view.rows[missing.row], &missing.tables)?;
        if values.len() != missing.tables.len() {
            let (got, asked) = (values.len(), missing.tables.len());
            return Err(contract_violation(format!(
                "{got} measures came for {asked} tables"
            )));
        }
        new.lock().add(missing, view.digests[missing.row], values)
    });
    // New measures are stored also after a failure or a cancellation.
    new.into_inner().flush()?;
    outcome
}

/// Reads the rows of one shard and measures those that lack it. Returns the number of these too.
pub(super) fn measure_shard(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    shard: &ShardLeaves,
) -> Result<(MeasuredShard, u64), StageError> {
    let mut read = measure(run, stage, &[shard], &mut RowProgress::new(run, shard.rows()))?;
    let shard = read.shards.pop();
    let shard = shard.ok_or_else(|| contract_violation("a shard was not read".to_owned()))?;
    Ok((shard, read.measured))
}

/// The rows of one shard with its tables of measures.
pub(super) struct ShardTables {
    rows: ShardRows,
    digests: Vec<Digest>,
    tables: Tables,
    /// Indices of the rows that the stage's own table lacks.
    pub(super) missing: Vec<usize>,
}

/// Rows, each with its digest.
struct RowsView<'a> {
    rows: &'a [Row],
    digests: &'a [Digest],
}

/// The tables of a shard that take new measures.
struct OpenTables<'a> {
    shard: u32,
    tables: &'a mut Tables,
}

/// Tables of one shard by their kind.
type Tables = BTreeMap<Table, KeptTable>;

/// A table and whether it has values that are not stored.
#[derive(Default)]
pub(super) struct KeptTable {
    measures: MeasureTable,
    is_new: bool,
}

impl ShardTables {
    /// Reads the stage's own table. The other tables are only read if a row must be measured.
    pub(super) fn load(
        run: &StageRun<'_>,
        stage: &dyn Measure,
        own: Table,
        rows: ShardRows,
    ) -> Result<Self, StageError> {
        let digests: Vec<Digest> = rows.rows.iter().map(row_digest).collect();
        let table = load(run.store, own, rows.shard)?;
        let is_whole = |measure: &[u8]| stage.blobs(measure).iter().all(|blob| run.store.contains(blob));
        let is_missing = |digest: &Digest| {
            !table
                .measures
                .0
                .get(digest)
                .is_some_and(|measure| is_whole(measure))
        };
        let missing: Vec<usize> = (0..)
            .zip(&digests)
            .filter(|(_, digest)| is_missing(digest))
            .map(|(at, _)| at)
            .collect();
        let mut tables = Tables::from([(own, table)]);
        if !missing.is_empty() {
            for other in stage.together().into_iter().filter(|other| *other != own) {
                tables.insert(other, load(run.store, other, rows.shard)?);
            }
        }
        Ok(Self {
            rows,
            digests,
            tables,
            missing,
        })
    }

    /// Returns the tables that a missing row is measured for: the stage's own, and those that lack it too.
    fn wanted(&self, row: usize, own: Table) -> Vec<Table> {
        let lacks = |table: &KeptTable| !table.measures.0.contains_key(&self.digests[row]);
        let wanted = self
            .tables
            .iter()
            .filter(|(kind, table)| **kind == own || lacks(table));
        wanted.map(|(kind, _)| *kind).collect()
    }

    /// Returns the data that is read while rows are measured, and the tables that are written.
    fn split(&mut self) -> (RowsView<'_>, OpenTables<'_>) {
        let view = RowsView {
            rows: &self.rows.rows,
            digests: &self.digests,
        };
        let tables = OpenTables {
            shard: self.rows.shard,
            tables: &mut self.tables,
        };
        (view, tables)
    }

    /// Returns the rows with their measures.
    fn finish(self, own: Table) -> Result<MeasuredShard, StageError> {
        let table = self.tables.get(&own);
        let value = |digest: &Digest| table.and_then(|table| table.measures.0.get(digest).cloned());
        let values: Option<Vec<_>> = self.digests.iter().map(value).collect();
        Ok(MeasuredShard {
            rows: self.rows,
            values: values.ok_or_else(|| contract_violation("a measure got lost".to_owned()))?,
        })
    }
}

/// Reads the table of a shard. A missing or damaged table is empty.
fn load(store: &Store, table: Table, shard: u32) -> Result<KeptTable, StageError> {
    let blob = store.memo(&table_key(table, shard)).map_err(store_error)?;
    let bytes = blob.and_then(|blob| store.get(&blob).ok());
    let measures = bytes
        .and_then(|bytes| MeasureTable::decode(&bytes))
        .unwrap_or_default();
    Ok(KeptTable {
        measures,
        is_new: false,
    })
}

/// The tables of some shards, with their new measures.
struct NewMeasures<'a, 'p> {
    run: &'a StageRun<'a>,
    shards: Vec<OpenTables<'a>>,
    progress: &'a mut RowProgress<'p>,
    flushed: Instant,
}

impl NewMeasures<'_, '_> {
    /// Adds the measures of a row. Stores the tables if that is due.
    fn add(&mut self, missing: &MissingRow, digest: Digest, values: Vec<Vec<u8>>) -> Result<(), StageError> {
        for (kind, value) in missing.tables.iter().zip(values) {
            if let Some(table) = self.shards[missing.shard].tables.get_mut(kind) {
                table.measures.0.insert(digest, Arc::from(value));
                table.is_new = true;
            }
        }
        self.progress.add(1);
        if self.flushed.elapsed() >= FLUSH_INTERVAL {
            self.flush()
        } else {
            Ok(())
        }
    }

    /// Stores the tables that have new measures.
    fn flush(&mut self) -> Result<(), StageError> {
        self.flushed = Instant::now();
        for OpenTables { shard, tables } in &mut self.shards {
            for (kind, table) in tables.iter_mut().filter(|(_, table)| table.is_new) {
                save(self.run, *kind, *shard, &table.measures)?;
                table.is_new = false;
            }
        }
        Ok(())
    }
}

/// Stores the table of a shard. It is kept as long as the result of this node.
fn save(run: &StageRun<'_>, table: Table, shard: u32, measures: &MeasureTable) -> Result<(), StageError> {
    let blob = run.store.put(&measures.encode()).map_err(store_error)?;
    run.store.put_memo(table_key(table, shard), blob, run.key.digest);
    Ok(())
}

/// Adds measures that a source made of its rows to the tables of their shard. Returns the number of rows measured.
pub(super) fn keep_fetched(
    run: &StageRun<'_>,
    shard: u32,
    rows: &[Row],
    measures: Vec<marf_stage::FetchedMeasure>,
) -> Result<u64, StageError> {
    let digests: BTreeMap<&str, Digest> = rows
        .iter()
        .map(|row| (row.id.as_str(), row_digest(row)))
        .collect();
    let mut tables = Tables::new();
    let mut measured = BTreeSet::new();
    for fetched in measures {
        let Some(digest) = digests.get(fetched.id.as_str()) else {
            return Err(contract_violation(format!(
                "a measure is of `{}`, which is not a row",
                fetched.id
            )));
        };
        let table = match tables.entry(fetched.table) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(place) => place.insert(load(run.store, fetched.table, shard)?),
        };
        table.measures.0.insert(*digest, Arc::from(fetched.measure));
        measured.insert(*digest);
    }
    for (kind, table) in &tables {
        save(run, *kind, shard, &table.measures)?;
    }
    Ok(measured.len() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_hold_all_shards_once_in_order() {
        for sizes in [
            vec![],
            vec![0, 0],
            vec![5000],
            vec![1; 10],
            vec![1999, 1, 1, 3000, 7],
        ] {
            let windows = windows(&sizes, |rows| *rows);
            assert_eq!(windows.concat(), sizes);
            let full = windows.iter().rev().skip(1);
            assert!(
                full.clone()
                    .all(|window| window.iter().sum::<u64>() >= WINDOW_ROWS),
                "{windows:?}"
            );
        }
    }
}
