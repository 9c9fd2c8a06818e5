//! Sources: one record a shard, so only shards whose fingerprint is new are fetched.

use std::collections::BTreeMap;

use marf_cache::{
    Digest,
    manifest::{LeafRef, Root},
};
use marf_stage::{COMPANIONS, Listing, Outputs, PHOTOS, Shard, Source, StageError, VERDICTS, Verdict};

use super::{Check, Counts, Job};
use crate::photos::{Part, bug, read_part, read_root, read_verdicts, write_part, write_verdicts};

pub(super) fn perform(job: &Job<'_>, source: &dyn Source) -> Result<(Outputs, Counts), StageError> {
    let Some(listing) = job.listing else {
        return Err(bug("a source runs without its listing".to_owned()));
    };
    let mut fetched = 0;
    let mut leaves = Vec::new();
    let mut verdicts = Vec::new();
    for (done, shard) in (1..).zip(&listing.shards) {
        job.ctx.check()?;
        let key = job.part_key("fetch", job.stage.params(), shard);
        let part = match job.part_hit(&key)? {
            Some(record) if is_whole(job, &record.outputs[PHOTOS].digest)? => {
                (record.outputs[PHOTOS].digest, record.outputs[VERDICTS].digest)
            }
            _ => {
                fetched += 1;
                let part = fetch(job, source, shard)?;
                let outputs = [(PHOTOS.to_owned(), part.0), (VERDICTS.to_owned(), part.1)];
                job.put_part(key, BTreeMap::from(outputs))?;
                part
            }
        };
        leaves.extend(read_root(&job.ctx, &part.0)?.leaves);
        verdicts.extend(read_verdicts(&job.ctx, &part.1)?);
        job.ctx.progress.at(done, listing.shards.len() as u64, "");
    }
    outputs(job, listing, leaves, verdicts, fetched)
}

/// Tells whether a shard's leaves are here, and if asked for also every blob its rows name.
fn is_whole(job: &Job<'_>, root: &Digest) -> Result<bool, StageError> {
    let leaves = read_root(&job.ctx, root)?.leaves;
    if !leaves.iter().all(|leaf| job.store.contains(&leaf.leaf)) {
        return Ok(false);
    }
    if job.check == Check::Names {
        return Ok(true);
    }
    for leaf in leaves {
        let rows = read_part(&job.ctx, leaf.shard, &[leaf])?.rows;
        let mut blobs = rows.iter().flat_map(|row| row.blobs.values());
        if !blobs.all(|blob| job.store.contains(blob)) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Brings one shard and returns its root and its verdicts.
fn fetch(job: &Job<'_>, source: &dyn Source, shard: &Shard) -> Result<(Digest, Digest), StageError> {
    let fetched = source.fetch(&job.ctx, shard.shard)?;
    let leaves = write_part(
        &job.ctx,
        Part {
            shard: shard.shard,
            rows: fetched.rows,
        },
    )?;
    let root = job.ctx.put(&Root { leaves }.encode())?;
    Ok((root, write_verdicts(&job.ctx, fetched.verdicts)?))
}

fn outputs(
    job: &Job<'_>,
    listing: &Listing,
    leaves: Vec<LeafRef>,
    verdicts: Vec<Verdict>,
    fetched: u64,
) -> Result<(Outputs, Counts), StageError> {
    let root = Root { leaves };
    let rejected = verdicts.iter().filter(|verdict| !verdict.keeps()).count() as u64;
    let companions = serde_json::to_vec(&listing.companions)
        .map_err(|error| bug(format!("companions cannot be kept: {error}")))?;
    let counts = [
        ("photos", root.rows()),
        ("rejected", rejected),
        ("fetched", fetched),
        ("shards", listing.shards.len() as u64),
    ];
    let outputs = [
        (PHOTOS, job.ctx.put(&root.encode())?),
        (VERDICTS, write_verdicts(&job.ctx, verdicts)?),
        (COMPANIONS, job.ctx.put(&companions)?),
    ];
    let declared = outputs
        .into_iter()
        .filter(|(name, _)| job.def.outputs.contains(name));
    Ok((
        declared.map(|(name, digest)| (name.to_owned(), digest)).collect(),
        counts
            .into_iter()
            .map(|(name, count)| (name.to_owned(), count))
            .collect(),
    ))
}
