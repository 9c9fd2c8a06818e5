//! A node's own last output as an input of its next run.

use marf_cache::{Digest, Store, StoreError};
use marf_stage::{EARLIER, Inputs, Listing, Stage, StageDef};

use crate::{
    key::{Key, node_key},
    record::RunRecord,
};

/// A node that needs a key.
pub(crate) struct KeyRequest<'a> {
    pub(crate) name: &'a str,
    pub(crate) def: &'a StageDef,
    pub(crate) stage: &'a dyn Stage,
    pub(crate) listing: Option<&'a Listing>,
}

/// Returns the key of a node, and its inputs with its own earlier output among them.
pub(crate) fn key_of(
    store: &Store,
    last: Option<&RunRecord>,
    request: &KeyRequest<'_>,
    inputs: Inputs,
) -> Result<(Key, Inputs), StoreError> {
    let inputs = with_earlier(store, last, request, inputs)?;
    let key = node_key(request.def, request.stage, &inputs, request.listing);
    Ok((key, inputs))
}

/// Adds the output of the node's last finished run as the input [`EARLIER`], if the stage asks for it and the store
/// has it.
///
/// If nothing else changed, the input is that of the last run: a node never runs because of its own output alone.
fn with_earlier(
    store: &Store,
    last: Option<&RunRecord>,
    request: &KeyRequest<'_>,
    inputs: Inputs,
) -> Result<Inputs, StoreError> {
    let Some(wanted) = request.stage.earlier() else {
        return Ok(inputs);
    };
    let key = last.and_then(|run| run.latest.get(request.name));
    let record = key.map(|key| store.record(key)).transpose()?.flatten();
    let Some(record) = record.filter(|record| record.stage == request.def.name) else {
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
    let unchanged = with(earlier_input(&record.manifest));
    if node_key(request.def, request.stage, &unchanged, request.listing).digest == record.key {
        return Ok(unchanged);
    }
    Ok(with(record.outputs.get(wanted).map(|output| output.digest)))
}

/// Returns the earlier output that a run had as input, from the text of its key.
fn earlier_input(manifest: &str) -> Option<Digest> {
    let value = |line: &str| {
        let (path, value) = line.split_once(" = ")?;
        (path.strip_prefix("inputs.") == Some(EARLIER)).then(|| value.parse().ok())?
    };
    manifest.lines().find_map(value)
}
