//! Objects that belong to a run as a whole: the pipeline as written and as it ran, the report, the table of verdicts.

use std::collections::BTreeMap;

use marf_cache::{Action, Digest, Output, Store, canonical_json};
use marf_engine::{NodeRun, NodeState, RunRecord, action_at, document};
use serde_json::Value;

use crate::error::Error;
use crate::session::Session;

/// Documents by name, as a run root holds them.
pub type Documents = BTreeMap<String, Output>;

/// Key of stages that can run on several devices.
const DEVICE: &str = "device";

/// Key of the stage `partial` that contains its training.
const TRAINING: &str = "train";

/// Stores a document.
///
/// # Errors
/// A store that cannot be written.
pub fn put(session: &Session, name: &str, bytes: &[u8]) -> Result<(String, Output), Error> {
    let output = Output {
        digest: session.store.put(bytes)?,
        bytes: bytes.len() as u64,
    };
    Ok((name.to_owned(), output))
}

/// Stores the pipeline as written and as it ran.
///
/// # Errors
/// A store that cannot be read or written.
pub fn pipeline(session: &Session, record: &RunRecord) -> Result<Documents, Error> {
    let resolved = canonical_json(&as_run(session, record)?);
    Ok(Documents::from([
        put(session, document::WRITTEN, session.written.as_bytes())?,
        put(session, document::RESOLVED, &resolved)?,
    ]))
}

/// Returns the pipeline with all overrides, and with `device = "cpu"` for each node that ran on the CPU, whoever chose it.
fn as_run(session: &Session, record: &RunRecord) -> Result<Value, Error> {
    let mut tree = session.tree.clone();
    for node in record.nodes.iter().filter(|node| node.parent.is_none()) {
        let action = node.key.map(|key| action_at(&session.store, &key)).transpose()?;
        let Some(action) = action.flatten() else { continue };
        let is_on_cpu =
            action.backend.is_none() && action.children.values().all(|child| child.backend.is_none());
        if is_on_cpu {
            put_on_cpu(&mut tree, node);
        }
    }
    Ok(tree)
}

/// Returns the resolved pipeline of a run.
///
/// # Errors
/// A run of an earlier version, whose root does not hold it, or a store that has lost it.
pub fn resolved(store: &Store, run: &RunRecord) -> Result<Value, Error> {
    let number = run.number;
    let resolved = run.documents.get(document::RESOLVED).ok_or_else(|| {
        Error::failed(format!(
            "run {number} is of an earlier version, whose root does not contain the pipeline"
        ))
    })?;
    let bytes = store.get(&resolved.digest)?;
    serde_json::from_slice(&bytes)
        .map_err(|error| Error::failed(format!("the pipeline of run {number}: {error}")))
}

/// Sets `device = "cpu"` in the table of a node of a pipeline, if its stage can run on several devices.
pub fn put_on_cpu(tree: &mut Value, node: &NodeRun) {
    let has_device = has_key(&node.stage, DEVICE);
    let table = tree["node"].get_mut(&node.name).and_then(Value::as_object_mut);
    if let Some(table) = table.filter(|_| has_device) {
        table.insert(DEVICE.to_owned(), "cpu".into());
    }
}

/// Returns the parameters of an action with the device of its backend, which is not part of the key. `partial` has it in the table of the
/// training.
pub fn params_of(action: &Action) -> Value {
    let mut children = action
        .children
        .values()
        .filter_map(|child| child.backend.as_deref());
    let backend = action.backend.as_deref().or_else(|| children.next());
    let device = Value::from(marf_field_gpu::device_with_id(backend).to_string());
    let mut params = action.params.clone();
    if has_key(&action.stage, DEVICE) {
        params[DEVICE] = device;
    } else if has_key(&action.stage, TRAINING) {
        params[TRAINING][DEVICE] = device;
    }
    params
}

/// Returns whether a stage has a parameter.
fn has_key(stage: &str, key: &str) -> bool {
    let mut stages = marf_stages::stages().iter().filter(|def| def.name == stage);
    stages.any(|def| (def.schema)().to_value()["properties"].get(key).is_some())
}

/// Returns a document of the last run of the pipeline, if all nodes that it shows are unchanged: this run
/// reused all of them, with the same keys.
///
/// # Errors
/// A store that cannot be read.
pub fn unchanged(
    session: &Session,
    record: &RunRecord,
    name: &str,
    is_shown: impl Fn(&str) -> bool,
) -> Result<Option<Output>, Error> {
    let shown = |run: &RunRecord| -> BTreeMap<String, Option<Digest>> {
        let nodes = run.nodes.iter().filter(|node| is_shown(&node.name));
        nodes.map(|node| (node.name.clone(), node.key)).collect()
    };
    let mut nodes = record.nodes.iter().filter(|node| is_shown(&node.name));
    if nodes.any(|node| node.state != NodeState::Reused) {
        return Ok(None);
    }
    let last = session.last()?.filter(|last| shown(last) == shown(record));
    let document = last.and_then(|last| last.documents.get(name).copied());
    Ok(document.filter(|document| session.store.contains(&document.digest)))
}
