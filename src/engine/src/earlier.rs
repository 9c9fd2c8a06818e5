//! A node's own last output as an input of its next run.

use marf_cache::{Digest, Store, StoreError};
use marf_stage::{EARLIER, Inputs, Listing, Stage, StageDef};

use crate::{RunRecord, key::node_key};

/// A node whose key is about to be made.
pub(crate) struct Asks<'a> {
    pub(crate) name: &'a str,
    pub(crate) def: &'a StageDef,
    pub(crate) stage: &'a dyn Stage,
    pub(crate) listing: Option<&'a Listing>,
}

/// Adds what the stage wants of its last finished run as the input [`EARLIER`]; none if there was no such run or
/// its output is not in the store any more.
///
/// Where nothing else changed, the input stays what that run had: a node never runs on its own output alone.
pub(crate) fn with_earlier(
    store: &Store,
    last: Option<&RunRecord>,
    asks: &Asks<'_>,
    inputs: Inputs,
) -> Result<Inputs, StoreError> {
    let Some(wanted) = asks.stage.earlier() else {
        return Ok(inputs);
    };
    let key = last.and_then(|run| run.latest.get(asks.name));
    let record = key.map(|key| store.record(key)).transpose()?.flatten();
    let Some(record) = record.filter(|record| record.stage == asks.def.name) else {
        return Ok(inputs);
    };
    let with = |earlier: Option<Digest>| {
        let mut inputs = inputs.clone();
        let earlier = earlier.filter(|digest| store.contains(digest));
        inputs
            .0
            .extend(earlier.map(|digest| (EARLIER.to_owned(), digest)));
        inputs
    };
    let as_then = with(used(&record.manifest));
    if node_key(asks.def, asks.stage, &as_then, asks.listing).digest == record.key {
        return Ok(as_then);
    }
    Ok(with(record.outputs.get(wanted).map(|output| output.digest)))
}

/// Returns the earlier output that a run itself used, from the text of its key.
fn used(manifest: &str) -> Option<Digest> {
    let value = |line: &str| {
        let (path, value) = line.split_once(" = ")?;
        (path.strip_prefix("inputs.") == Some(EARLIER)).then(|| value.parse().ok())?
    };
    manifest.lines().find_map(value)
}
