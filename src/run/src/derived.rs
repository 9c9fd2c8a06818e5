//! Nodes that are added to the results of a run. Nothing is fetched, and the results of the run are reused.

use std::path::Path;

use marf_cache::Store;
use marf_config::{GlobalOptions, PipelineDocument, check_tree};
use marf_engine::{NodeRun, Options, Purpose, RunRecord, RunSource, action_at, differences};
use marf_model::Run;
use marf_provenance::replay::recorded;
use marf_stage::Params;
use serde_json::{Map, Value, json};

use crate::context::Context;
use crate::documents::resolved;
use crate::error::{Diagnostic, Error};
use crate::execute::{execute, options};
use crate::session::Session;

/// A node that is added to a run.
#[derive(Debug, Clone)]
pub struct AddedNode {
    /// Its name.
    pub name: String,
    /// Its table, as pipeline.toml would have it.
    pub table: Value,
}

/// Returns the table of a node with these parameters. Keys that have their default are left out, so that options of the command line hold for
/// them.
///
/// # Errors
/// Parameters that JSON cannot hold.
pub fn table_of<P: Params + Default>(params: &P) -> Result<Map<String, Value>, Error> {
    let json = |params: &P| serde_json::to_value(params).map_err(|error| Error::failed(error.to_string()));
    let defaults = json(&P::default())?;
    let given = json(params)?;
    let given = given.as_object().into_iter().flatten();
    let other = given.filter(|(key, value)| defaults.get(key) != Some(value));
    let uses = ("uses".to_owned(), json!(P::STAGE));
    Ok(other
        .map(|(key, value)| (key.clone(), value.clone()))
        .chain([uses])
        .collect())
}

/// A run of added nodes, and the session that it was made in.
pub struct DerivedRun {
    /// The session.
    pub session: Session,
    /// The record of the run.
    pub record: RunRecord,
}

/// Runs more nodes on the results of a run, in its store. Archives are read in the state that the run recorded, so no server is asked, and
/// every other node has its result already.
///
/// # Errors
/// A run with a lost object, or any error that keeps the nodes from running.
pub fn run_nodes(
    context: &Context,
    store: Store,
    run: &RunRecord,
    purpose: Purpose,
    nodes: &[AddedNode],
) -> Result<DerivedRun, Error> {
    let names: Vec<String> = nodes.iter().map(|node| node.name.clone()).collect();
    let mut given = GlobalOptions {
        device: context.config.device.clone(),
        ..GlobalOptions::default()
    };
    let tree = {
        let lineage = Run::new(&store, run.clone())?;
        let mut tree = resolved(&store, run)?;
        for node in nodes {
            tree["node"][&node.name] = node.table.clone();
        }
        for source in lineage
            .nodes
            .iter()
            .filter(|node| node.is_source() && node.run.state.is_good())
        {
            given
                .recorded
                .insert(source.run.name.clone(), recorded(&store, source)?);
        }
        tree
    };
    let pipeline = check_tree(&tree, &given, Path::new("")).map_err(|error| {
        let names = names.join("`, `");
        let message = format!("`{names}` on run {}: {}", run.number, error.message);
        Error::Usage(Diagnostic::with_hint(message, error.hint))
    })?;
    let source = RunSource::Derived {
        from: run.root,
        purpose,
    };
    let text = json!(tree).to_string();
    let document = PipelineDocument { pipeline, text };
    let session = Session::new(context, document, run.pipeline.clone(), source, store)?;
    let options = Options {
        to: names,
        ..options(&session)
    };
    let record = execute(&session, &options)?.done()?;
    for node in made_otherwise(run, &record) {
        if options.to.contains(&node.name) {
            continue; // It is the request itself, which may differ from an earlier one.
        }
        let changes = changes(&session.store, run.node(&node.name), node)?;
        context.warn(format!(
            "`{}` was computed again, since its result in run {} is out of date ({changes}): the files are of the new result",
            node.name, run.number
        ));
    }
    Ok(DerivedRun { session, record })
}

/// Returns the nodes whose key and outputs differ from those of an earlier run, because a stage has another version since.
fn made_otherwise<'r>(before: &RunRecord, after: &'r RunRecord) -> Vec<&'r NodeRun> {
    let is_other = |node: &&NodeRun| {
        let old = before.node(&node.name).filter(|old| old.state.is_good());
        old.is_some_and(|old| old.key != node.key && old.outputs != node.outputs)
    };
    let good = after
        .nodes
        .iter()
        .filter(|node| node.parent.is_none() && node.state.is_good());
    good.filter(is_other).collect()
}

/// Returns the differences between the actions of two results of a node.
fn changes(store: &Store, before: Option<&NodeRun>, after: &NodeRun) -> Result<String, Error> {
    let action = |node: Option<&NodeRun>| match node.and_then(|node| node.key) {
        Some(key) => action_at(store, &key),
        None => Ok(None),
    };
    let Some((before, after)) = action(before)?.zip(action(Some(after))?) else {
        return Ok("the action of one of them is not in the store".to_owned());
    };
    let changes = differences(&before, &after);
    Ok(changes
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;

    /// A run of one training, from its key and its weights.
    fn run(key: &str, weights: &str) -> RunRecord {
        let [key, weights] = [key, weights].map(|text| Digest::from_content(text.as_bytes()));
        let node = json!({
            "name": "train", "stage": "train", "parent": null, "edges": [], "key": key, "state": "finished", "reason": "",
            "seconds": 1.0, "outputs": {"weights.safetensors": {"digest": weights, "bytes": 1}}, "counts": {},
        });
        let run = json!({
            "format": marf_engine::RUN_FORMAT, "id": "a", "source": {"kind": "pipeline", "file": "p.toml"}, "pipeline": "p",
            "command": "", "program": "", "started_unix_s": 0, "seconds": 1.0, "outcome": "done",
            "digest": key, "threads": 1, "nodes": [node], "latest": {},
        });
        serde_json::from_value(run).unwrap()
    }

    #[test]
    fn a_node_is_told_that_was_keyed_otherwise_and_gave_something_else() {
        let before = run("version 11", "a");
        let after = run("version 12", "b");
        assert_eq!(made_otherwise(&before, &after)[0].name, "train");
        for same in [
            run("version 11", "a"),
            run("version 12", "a"),
            run("version 11", "b"),
        ] {
            assert!(made_otherwise(&before, &same).is_empty());
        }
    }
}
