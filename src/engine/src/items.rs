//! Sets of items: reads and writes roots, leaves and verdicts.

use std::{collections::BTreeMap, sync::Arc};

use marf_cache::{
    Digest,
    manifest::{Leaf, LeafRef, ManifestError, ROWS_A_LEAF, Root, Row},
};
use marf_stage::{Ctx, StageError, Verdict};

use crate::errors::contract_violation;

/// The rows of one shard.
#[derive(Clone)]
pub(crate) struct ShardRows {
    pub(crate) shard: u32,
    pub(crate) rows: Vec<Row>,
}

/// A shard of a set: its leaves.
pub(crate) struct ShardLeaves {
    pub(crate) shard: u32,
    pub(crate) leaves: Vec<LeafRef>,
}

impl ShardLeaves {
    /// Returns the number of its rows.
    pub(crate) fn rows(&self) -> u64 {
        rows_of(&self.leaves)
    }

    /// Returns the inputs of a part that reads the leaves.
    pub(crate) fn inputs(&self) -> BTreeMap<String, Digest> {
        let leaves = self.leaves.iter().enumerate();
        leaves
            .map(|(index, leaf)| (leaf_name(index), leaf.leaf))
            .collect()
    }
}

/// Returns the name of the input that is a leaf of a shard.
pub(crate) fn leaf_name(index: usize) -> String {
    format!("rows.{index}")
}

/// Reads a set.
pub(crate) fn read_set(ctx: &Ctx<'_>, root: &Digest) -> Result<Root, StageError> {
    Root::read(root, |digest| ctx.get(digest))
}

/// Stores a set.
pub(crate) fn write_set(ctx: &Ctx<'_>, leaves: Vec<LeafRef>) -> Result<Digest, StageError> {
    Root { leaves }.write(|bytes| ctx.put(bytes))
}

/// Returns the leaves of each shard, in order.
pub(crate) fn by_shard(root: &Root) -> Vec<ShardLeaves> {
    let runs = root.leaves.chunk_by(|a, b| a.shard == b.shard);
    let shard = |run: &[LeafRef]| ShardLeaves {
        shard: run[0].shard,
        leaves: run.to_vec(),
    };
    runs.map(shard).collect()
}

/// Returns the number of rows of a shard.
pub(crate) fn rows_of(leaves: &[LeafRef]) -> u64 {
    leaves.iter().map(|leaf| u64::from(leaf.rows)).sum()
}

/// Reads the rows of a shard's leaves, in order.
pub(crate) fn read_shard(ctx: &Ctx<'_>, shard: &ShardLeaves) -> Result<ShardRows, StageError> {
    let mut rows = Vec::new();
    for leaf in &shard.leaves {
        let read =
            Leaf::decode(&ctx.get(&leaf.leaf)?).map_err(|error| unreadable("leaf", &leaf.leaf, &error))?;
        rows.extend(read.rows);
    }
    Ok(ShardRows {
        shard: shard.shard,
        rows,
    })
}

/// Stores the rows of a shard as leaves. Empty without rows.
pub(crate) fn write_shard(ctx: &Ctx<'_>, rows: ShardRows) -> Result<Vec<LeafRef>, StageError> {
    let shard = rows.shard;
    let whole = Leaf::new(rows.rows)
        .map_err(|error| StageError::new(format!("shard {shard} cannot be kept: {error}")))?;
    let leaves = whole.rows.chunks(ROWS_A_LEAF).map(|rows| {
        let leaf = Leaf { rows: rows.to_vec() };
        leaf_ref(ctx, shard, leaf.rows.len(), &leaf.encode())
    });
    leaves.collect()
}

/// Stores the verdicts of a shard as leaves, one JSON line each, sorted by id, then by file.
pub(crate) fn write_verdicts(
    ctx: &Ctx<'_>,
    shard: u32,
    mut verdicts: Vec<Verdict>,
) -> Result<Vec<LeafRef>, StageError> {
    verdicts.sort_by(|a, b| (&a.id, &a.file).cmp(&(&b.id, &b.file)));
    let leaves = verdicts.chunks(ROWS_A_LEAF).map(|verdicts| {
        let mut bytes = Vec::new();
        for verdict in verdicts {
            serde_json::to_writer(&mut bytes, verdict).map_err(|error| {
                StageError::new(format!("verdict on `{}` cannot be kept: {error}", verdict.id))
            })?;
            bytes.push(b'\n');
        }
        leaf_ref(ctx, shard, verdicts.len(), &bytes)
    });
    leaves.collect()
}

fn leaf_ref(ctx: &Ctx<'_>, shard: u32, rows: usize, bytes: &[u8]) -> Result<LeafRef, StageError> {
    Ok(LeafRef {
        shard,
        leaf: ctx.put(bytes)?,
        rows: rows as u32,
    })
}

/// Reads references to leaves that are an output of a part.
pub(crate) fn read_refs(ctx: &Ctx<'_>, digest: &Digest) -> Result<Vec<LeafRef>, StageError> {
    let bytes: Arc<[u8]> = ctx.get(digest)?;
    Root::decode_leaves(&bytes).map_err(|error| unreadable("list of leaves", digest, &error))
}

/// Stores references to leaves as an output of a part.
pub(crate) fn write_refs(ctx: &Ctx<'_>, leaves: &[LeafRef]) -> Result<Digest, StageError> {
    ctx.put(&Root::encode_leaves(leaves))
}

/// Returns the rows that their verdicts keep. There must be one verdict for each row, in the same order.
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
