//! Sources: each shard has its record, so only shards with a new fingerprint are fetched.

use std::collections::BTreeMap;

use marf_cache::{Digest, FINGERPRINT, manifest::LeafRef};
use marf_stage::{COMPANIONS, Origin, Shard, Source, StageError};

use super::{
    measure::keep_fetched,
    stage_run::{Counts, Part, PartKind, PartedOutputs, StageRun},
};
use crate::{
    errors::contract_violation,
    items::{ShardRows, write_shard, write_verdicts},
    key::Key,
    listing::{SourceListing, companions},
    stage_io::StoreBlobs,
};

/// Fetches the shards that have no record, and joins all shards to one set.
///
/// Also returns the present listing: some shards show their contents only in a fetch.
pub(super) fn execute(
    run: &StageRun<'_>,
    source: &dyn Source,
) -> Result<(PartedOutputs, Option<SourceListing>), StageError> {
    let Some(listed) = run.listed else {
        return Err(contract_violation("a source runs without its listing".to_owned()));
    };
    let mut listing = listed.listing.clone();
    let total = listing.shards.len() as u64;
    let fetch_key = |shard: &Shard| run.part_key(PartKind::Fetch, shard.shard, fetch_inputs(shard));
    run.fetch_parts(listing.shards.iter().map(|shard| fetch_key(shard).digest))?;
    let (mut fetched, mut measured) = (0, 0);
    let mut keys = Vec::new();
    let mut parts = Vec::new();
    for (done, shard) in (1..).zip(&mut listing.shards) {
        run.ctx.check()?;
        let key = fetch_key(shard);
        let (key, part) = match run.part_hit(&key.digest)? {
            Some(part) if has_leaves(run, &part.photos) => (key, part),
            _ => {
                fetched += 1;
                let (key, part, new) = fetch(run, source, shard)?;
                measured += new;
                (key, part)
            }
        };
        keys.push((shard.shard, key.digest));
        parts.push(part);
        run.ctx.progress.at(done, total, "");
    }
    let counts = Counts::from([
        ("fetched".to_owned(), fetched),
        ("measured".to_owned(), measured),
        ("shards".to_owned(), total),
    ]);
    let listed = SourceListing::new(listing);
    listed.store(&run.ctx)?;
    let mut joined = run.join(keys, parts.into_iter().collect(), counts)?;
    if run.def.outputs.contains(&COMPANIONS) {
        let companions = run.ctx.put(&companions(&listed.listing))?;
        joined.outputs.insert(COMPANIONS.to_owned(), companions);
    }
    joined
        .outputs
        .retain(|name, _| run.def.outputs.contains(&name.as_str()));
    Ok((joined, Some(listed)))
}

/// Returns the inputs of the part that fetches a shard.
pub(super) fn fetch_inputs(shard: &Shard) -> BTreeMap<String, Digest> {
    BTreeMap::from([(FINGERPRINT.to_owned(), shard.fingerprint)])
}

fn has_leaves(run: &StageRun<'_>, leaves: &[LeafRef]) -> bool {
    leaves.iter().all(|leaf| run.store.contains(&leaf.leaf))
}

/// Fetches one shard and stores the result under the fingerprint of its contents. Also returns the number of rows measured.
fn fetch(run: &StageRun<'_>, source: &dyn Source, shard: &mut Shard) -> Result<(Key, Part, u64), StageError> {
    let blobs = StoreBlobs::new(run.store);
    let ctx = run.with_blobs(&blobs);
    let fetched = source.fetch(&ctx, shard.shard)?;
    fetched.warnings.iter().for_each(|warning| (run.warn)(warning));
    shard.fingerprint = fetched.fingerprint.unwrap_or(shard.fingerprint);
    let measured = keep_fetched(run, shard.shard, &fetched.rows, fetched.measures)?;
    let rows = ShardRows {
        shard: shard.shard,
        rows: fetched.rows,
    };
    let part = Part {
        photos: write_shard(&ctx, rows)?,
        verdicts: write_verdicts(&ctx, shard.shard, fetched.verdicts)?,
        added: None,
    };
    let origins = if fetched.origins.is_empty() {
        None
    } else {
        Some(ctx.put(&Origin::encode(&fetched.origins))?)
    };
    let key = run.part_key(PartKind::Fetch, shard.shard, fetch_inputs(shard));
    run.put_source_part(&key, &part, &blobs, origins)?;
    Ok((key, part, measured))
}
