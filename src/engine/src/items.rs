//! Sets of items: reads and writes roots, leaves and verdicts.

use marf_cache::{
    Digest,
    manifest::{Leaf, LeafRef, ManifestError, ROWS_A_LEAF, Root, Row},
};
use marf_stage::{Ctx, StageError, Verdict};

use crate::errors::contract_violation;

/// The rows of one shard.
pub(crate) struct ShardRows {
    pub(crate) shard: u32,
    pub(crate) rows: Vec<Row>,
}

/// Reads the root of a set.
pub(crate) fn read_root(ctx: &Ctx<'_>, root: &Digest) -> Result<Root, StageError> {
    Root::decode(&ctx.get(root)?).map_err(|error| unreadable("set", root, &error))
}

/// Returns the leaves of each shard, in order.
pub(crate) fn by_shard(root: &Root) -> Vec<(u32, Vec<LeafRef>)> {
    let runs = root.leaves.chunk_by(|a, b| a.shard == b.shard);
    runs.map(|run| (run[0].shard, run.to_vec())).collect()
}

/// Reads the rows of a shard's leaves, in order.
pub(crate) fn read_shard(ctx: &Ctx<'_>, shard: u32, leaves: &[LeafRef]) -> Result<ShardRows, StageError> {
    let mut rows = Vec::new();
    for leaf in leaves {
        let read =
            Leaf::decode(&ctx.get(&leaf.leaf)?).map_err(|error| unreadable("leaf", &leaf.leaf, &error))?;
        rows.extend(read.rows);
    }
    Ok(ShardRows { shard, rows })
}

/// Reads all rows of a set, shard by shard.
pub(crate) fn read_all_shards(ctx: &Ctx<'_>, root: &Digest) -> Result<Vec<ShardRows>, StageError> {
    let shards = by_shard(&read_root(ctx, root)?);
    shards
        .iter()
        .map(|(shard, leaves)| read_shard(ctx, *shard, leaves))
        .collect()
}

/// Stores the rows of a shard as leaves; none if there are no rows.
pub(crate) fn write_shard(ctx: &Ctx<'_>, rows: ShardRows) -> Result<Vec<LeafRef>, StageError> {
    let shard = rows.shard;
    let whole = Leaf::new(rows.rows)
        .map_err(|error| StageError::new(format!("shard {shard} cannot be kept: {error}")))?;
    let leaves = whole.rows.chunks(ROWS_A_LEAF).map(|rows| {
        let leaf = Leaf { rows: rows.to_vec() };
        Ok(LeafRef {
            shard,
            leaf: ctx.put(&leaf.encode())?,
            rows: leaf.rows.len() as u32,
        })
    });
    leaves.collect()
}

/// Stores verdicts as one JSON line each, sorted by id, then by file.
pub(crate) fn write_verdicts(ctx: &Ctx<'_>, mut verdicts: Vec<Verdict>) -> Result<Digest, StageError> {
    verdicts.sort_by(|a, b| (&a.id, &a.file).cmp(&(&b.id, &b.file)));
    let mut bytes = Vec::new();
    for verdict in &verdicts {
        serde_json::to_writer(&mut bytes, verdict).map_err(|error| {
            StageError::new(format!("verdict on `{}` cannot be kept: {error}", verdict.id))
        })?;
        bytes.push(b'\n');
    }
    ctx.put(&bytes)
}

/// Reads what [`write_verdicts`] stored.
pub(crate) fn read_verdicts(ctx: &Ctx<'_>, digest: &Digest) -> Result<Vec<Verdict>, StageError> {
    let bytes = ctx.get(digest)?;
    let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    lines
        .map(|line| {
            serde_json::from_slice(line).map_err(|error| unreadable("verdict", digest, &error.into()))
        })
        .collect()
}

/// Returns the rows that their verdicts keep; there must be one verdict for each row, in the same order.
pub(crate) fn kept(rows: Vec<Row>, verdicts: &[Verdict]) -> Result<Vec<Row>, StageError> {
    if rows.len() != verdicts.len() {
        let (got, wanted) = (verdicts.len(), rows.len());
        return Err(contract_violation(format!(
            "{got} verdicts came for {wanted} photos"
        )));
    }
    if let Some((row, verdict)) = rows
        .iter()
        .zip(verdicts)
        .find(|(row, verdict)| row.id != verdict.id)
    {
        let (row, verdict) = (&row.id, &verdict.id);
        return Err(contract_violation(format!(
            "the verdict on `{row}` is about `{verdict}`"
        )));
    }
    let pairs = rows.into_iter().zip(verdicts);
    Ok(pairs
        .filter(|(_, verdict)| verdict.keeps())
        .map(|(row, _)| row)
        .collect())
}

fn unreadable(what: &str, digest: &Digest, error: &ManifestError) -> StageError {
    StageError::new(format!("the {what} {} cannot be read", digest.short())).cause(error.to_string())
}
