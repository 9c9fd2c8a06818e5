//! Sources: each shard has its record, so only shards with a new fingerprint are fetched.

use std::collections::BTreeMap;

use marf_cache::{
    Digest,
    manifest::{LeafRef, Root},
};
use marf_stage::{COMPANIONS, Listing, Outputs, PHOTOS, Shard, Source, StageError, VERDICTS, Verdict};

use super::stage_run::{BlobCheck, Counts, StageRun};
use crate::{
    errors::contract_violation,
    items::{ShardRows, read_root, read_shard, read_verdicts, write_shard, write_verdicts},
};

/// Fetches the shards that have no record, and joins all shards to one set.
pub(super) fn execute(run: &StageRun<'_>, source: &dyn Source) -> Result<(Outputs, Counts), StageError> {
    let Some(listing) = run.listing else {
        return Err(contract_violation("a source runs without its listing".to_owned()));
    };
    let mut fetched = 0;
    let mut leaves = Vec::new();
    let mut verdicts = Vec::new();
    for (done, shard) in (1..).zip(&listing.shards) {
        run.ctx.check()?;
        let key = run.part_key("fetch", run.stage.params(), shard);
        let part = match run.part_hit(&key)? {
            Some(record) if is_complete(run, &record.outputs[PHOTOS].digest)? => {
                (record.outputs[PHOTOS].digest, record.outputs[VERDICTS].digest)
            }
            _ => {
                fetched += 1;
                let part = fetch(run, source, shard)?;
                let outputs = [(PHOTOS.to_owned(), part.0), (VERDICTS.to_owned(), part.1)];
                run.put_part(key, BTreeMap::from(outputs))?;
                part
            }
        };
        leaves.extend(read_root(&run.ctx, &part.0)?.leaves);
        verdicts.extend(read_verdicts(&run.ctx, &part.1)?);
        run.ctx.progress.at(done, listing.shards.len() as u64, "");
    }
    outputs(run, listing, leaves, verdicts, fetched)
}

/// Tells whether a shard's leaves are in the store, and if the run checks blobs, every blob its rows name.
fn is_complete(run: &StageRun<'_>, root: &Digest) -> Result<bool, StageError> {
    let leaves = read_root(&run.ctx, root)?.leaves;
    if !leaves.iter().all(|leaf| run.store.contains(&leaf.leaf)) {
        return Ok(false);
    }
    if run.check == BlobCheck::Names {
        return Ok(true);
    }
    for leaf in leaves {
        let rows = read_shard(&run.ctx, leaf.shard, &[leaf])?.rows;
        let mut blobs = rows.iter().flat_map(|row| row.blobs.values());
        if !blobs.all(|blob| run.store.contains(blob)) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Fetches one shard and returns the digests of its root and its verdicts.
fn fetch(run: &StageRun<'_>, source: &dyn Source, shard: &Shard) -> Result<(Digest, Digest), StageError> {
    let fetched = source.fetch(&run.ctx, shard.shard)?;
    let leaves = write_shard(
        &run.ctx,
        ShardRows {
            shard: shard.shard,
            rows: fetched.rows,
        },
    )?;
    let root = run.ctx.put(&Root { leaves }.encode())?;
    Ok((root, write_verdicts(&run.ctx, fetched.verdicts)?))
}

/// Stores the set, the verdicts and the companions.
fn outputs(
    run: &StageRun<'_>,
    listing: &Listing,
    leaves: Vec<LeafRef>,
    verdicts: Vec<Verdict>,
    fetched: u64,
) -> Result<(Outputs, Counts), StageError> {
    let root = Root { leaves };
    let rejected = verdicts.iter().filter(|verdict| !verdict.keeps()).count() as u64;
    let companions = serde_json::to_vec(&listing.companions)
        .map_err(|error| contract_violation(format!("companions cannot be kept: {error}")))?;
    let counts = [
        ("photos", root.rows()),
        ("rejected", rejected),
        ("fetched", fetched),
        ("shards", listing.shards.len() as u64),
    ];
    let outputs = [
        (PHOTOS, run.ctx.put(&root.encode())?),
        (VERDICTS, write_verdicts(&run.ctx, verdicts)?),
        (COMPANIONS, run.ctx.put(&companions)?),
    ];
    let declared = outputs
        .into_iter()
        .filter(|(name, _)| run.def.outputs.contains(name));
    Ok((
        declared.map(|(name, digest)| (name.to_owned(), digest)).collect(),
        counts
            .into_iter()
            .map(|(name, count)| (name.to_owned(), count))
            .collect(),
    ))
}
