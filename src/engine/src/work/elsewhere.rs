//! Measures that other machines compute, one part a shard. The results of a part are added to the tables of measures, as if they had been
//! measured here.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use marf_cache::Digest;
use marf_stage::{Measure, Outputs, StageError, Table};
use rayon::prelude::*;

use super::{
    measure::{ShardTables, add_to_table, windows},
    stage_run::{PartKind, StageRun},
};
use crate::{
    errors::{contract_violation, store_error},
    executor::{Order, OtherMachines, PartOrder},
    items::{ShardLeaves, read_shard},
    measure_table::{MeasureTable, row_digest},
    stage_io::StoreBlobs,
};

/// Shards whose measures are stored at once: these are in memory until then.
const SHARDS_AT_ONCE: usize = 1_000;

/// Measures shards on other machines, if most of their measures are missing and there are machines that take them. Returns the number of
/// rows measured. The remaining rows are measured here.
pub(super) fn measure_elsewhere(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    shards: &[&ShardLeaves],
) -> Result<u64, StageError> {
    let (Some(elsewhere), Some(own)) = (run.elsewhere, stage.table()) else {
        return Ok(0);
    };
    let photos = |parts: &[(u32, PartOrder)]| parts.iter().map(|(_, part)| part.photos).sum::<u64>();
    let parts = lacking(run, stage, own, shards)?;
    let total = photos(&parts);
    if parts.is_empty() || !elsewhere.executor.takes_parts(&run.key.action, total) {
        return Ok(0);
    }
    let (numbers, orders): (Vec<u32>, Vec<PartOrder>) = parts.into_iter().unzip();
    order(run, elsewhere, &orders)?;
    let taken: Vec<(u32, &PartOrder)> = numbers.into_iter().zip(&orders).collect();
    for some in taken.chunks(SHARDS_AT_ONCE) {
        run.ctx.check()?;
        for (shard, order) in some {
            take_over(run, stage, *shard, &order.key)?;
        }
        run.store.commit().map_err(store_error)?;
    }
    Ok(total)
}

/// Returns the parts for shards in which over half of the rows are not measured: a part measures all rows.
fn lacking(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    own: Table,
    shards: &[&ShardLeaves],
) -> Result<Vec<(u32, PartOrder)>, StageError> {
    let mut parts = Vec::new();
    for window in windows(shards, |shard| shard.rows()) {
        run.ctx.check()?;
        let found = window.par_iter().map(|shard| {
            let rows = read_shard(&run.ctx, shard)?;
            let photos = rows.rows.len() as u64;
            let missing = ShardTables::load(run, stage, own, rows)?.missing.len() as u64;
            Ok((missing * 2 > photos).then(|| part(run, shard, photos)))
        });
        let found: Vec<Option<_>> = found.collect::<Result<_, StageError>>()?;
        parts.extend(found.into_iter().flatten());
    }
    Ok(parts)
}

fn part(run: &StageRun<'_>, shard: &ShardLeaves, photos: u64) -> (u32, PartOrder) {
    let key = run.part_key(PartKind::Measure, shard.shard, shard.inputs());
    let action = key.action.encode();
    let order = PartOrder {
        key: key.digest,
        action,
        photos,
    };
    (shard.shard, order)
}

fn order(run: &StageRun<'_>, elsewhere: &OtherMachines<'_>, parts: &[PartOrder]) -> Result<(), StageError> {
    run.store.commit().map_err(store_error)?;
    let order = Order {
        node: run.node,
        key: run.key.digest,
        action: &run.key.action,
        needs: elsewhere.needs,
        results: &elsewhere.results,
        store: run.store,
        progress: run.ctx.progress,
        cancel: run.ctx.cancel,
    };
    elsewhere.executor.execute_parts(&order, parts)
}

/// Adds the measures of a part to the tables of its shard.
fn take_over(run: &StageRun<'_>, stage: &dyn Measure, shard: u32, key: &Digest) -> Result<(), StageError> {
    let record = run.store.hit(key).map_err(store_error)?;
    let Some(record) = record else {
        return Err(contract_violation(format!(
            "shard {shard} was measured on another machine, but its measures are missing"
        )));
    };
    for table in stage.together() {
        let output = record
            .outputs
            .get(table.name)
            .ok_or_else(|| unread(shard, table))?;
        let bytes = run.store.get(&output.digest).map_err(store_error)?;
        let measures = MeasureTable::decode(&bytes).ok_or_else(|| unread(shard, table))?;
        add_to_table(run, table, shard, measures)?;
    }
    Ok(())
}

fn unread(shard: u32, table: Table) -> StageError {
    contract_violation(format!(
        "shard {shard} was measured on another machine, but its table `{}` is incomplete",
        table.name
    ))
}

/// Measures all rows of a shard for all tables that one look at them fills, and stores these with the record of the part. What
/// earlier runs have measured is not looked at, so the result follows from the rows alone.
pub(super) fn measure_part(
    run: &StageRun<'_>,
    stage: &dyn Measure,
    shard: &ShardLeaves,
) -> Result<(), StageError> {
    let tables = stage.together();
    let rows = read_shard(&run.ctx, shard)?.rows;
    let blobs = StoreBlobs::new(run.store);
    let ctx = run.with_blobs(&blobs);
    let (done, total) = (AtomicU64::new(0), rows.len() as u64);
    let measured = rows.par_iter().map(|row| {
        ctx.check()?;
        let values = stage.measure(&ctx, row, &tables)?;
        ctx.progress
            .at(done.fetch_add(1, Ordering::Relaxed) + 1, total, "");
        if values.len() == tables.len() {
            Ok(values)
        } else {
            Err(contract_violation(format!(
                "{} measures came for {} tables",
                values.len(),
                tables.len()
            )))
        }
    });
    let measured: Vec<Vec<Vec<u8>>> = measured.collect::<Result<_, StageError>>()?;
    let mut filled: BTreeMap<Table, MeasureTable> = BTreeMap::new();
    for (row, values) in rows.iter().zip(measured) {
        let digest = row_digest(row);
        for (table, value) in tables.iter().zip(values) {
            filled
                .entry(*table)
                .or_default()
                .0
                .insert(digest, Arc::from(value));
        }
    }
    let mut outputs = Outputs::new();
    for (table, measures) in filled {
        outputs.insert(table.name.to_owned(), ctx.put(&measures.encode())?);
    }
    run.put_outputs(run.key, outputs, blobs.take_stored(), None)
}
