//! Nodes that are added to the results of a run: nothing is fetched, and what the run made is reused.

use std::path::Path;

use marf_cache::Store;
use marf_config::{GlobalOptions, Loaded, check_tree};
use marf_engine::{NodeRun, Options, RunRecord};
use marf_provenance::lineage::Lineage;
use marf_provenance::replay::recorded;
use serde_json::{Value, json};

use crate::context::Context;
use crate::documents::resolved;
use crate::error::{Diagnostic, Error};
use crate::execute::{execute, options};
use crate::session::{EXPORTS, Session, TRADES, last_of};

/// Returns the last run, or the one of a number, in which a node ended well.
///
/// # Errors
/// No such run: names the nodes of the last one.
pub fn run_with(
    context: &Context,
    store: &Store,
    number: Option<u64>,
    node: &str,
) -> Result<RunRecord, Error> {
    let has = |run: &RunRecord| run.node(node).is_some_and(|node| node.state.is_good());
    run_where(context, store, number, has, |run| without(run, node))
}

/// Returns the last run, or the one of a number, that has something; `without` is the error of a run that has it not. Points of a trade
/// are only taken by their number: their fields are not what the pipeline asks for.
///
/// # Errors
/// No such run.
pub fn run_where(
    context: &Context,
    store: &Store,
    number: Option<u64>,
    has: impl Fn(&RunRecord) -> bool,
    without: impl Fn(&RunRecord) -> Error,
) -> Result<RunRecord, Error> {
    if let Some(number) = number {
        let run = marf_engine::run_of(store, number)?;
        return if has(&run) { Ok(run) } else { Err(without(&run)) };
    }
    let runs = marf_engine::runs(store, context.warnings())?;
    let is_asked_for = |run: &&RunRecord| !run.pipeline.ends_with(TRADES) && has(run);
    let last = runs.iter().rev().find(is_asked_for).cloned();
    let none = || match last_of(&runs) {
        Some(run) => without(run),
        None => Error::Failed(Diagnostic::new("there is no run yet").hint("`marf run` makes one")),
    };
    last.ok_or_else(none)
}

/// Returns the error of a run in which a node did not end well, with the names of those that did.
pub fn without(run: &RunRecord, node: &str) -> Error {
    let good = run
        .nodes
        .iter()
        .filter(|node| node.parent.is_none() && node.state.is_good());
    let known: Vec<&str> = good.map(|node| node.name.as_str()).collect();
    Error::Usage(
        Diagnostic::new(format!("run {} has no result of a node `{node}`", run.number)).hint(format!(
            "its nodes are {}; or name another run with --run",
            known.join(", ")
        )),
    )
}

/// A node that is added to a run.
#[derive(Debug, Clone)]
pub struct AddedNode {
    /// Its name.
    pub name: String,
    /// Its table, as pipeline.toml would have it.
    pub table: Value,
}

/// A run of added nodes, and the session that it was made in.
pub struct DerivedRun {
    /// The session.
    pub session: Session,
    /// The record of the run.
    pub record: RunRecord,
}

/// Runs more nodes on the results of a run, in its store. Archives are read as they were met then, so that nothing is asked of a
/// server, and every other node has its result already.
///
/// # Errors
/// A run of which something is lost; whatever keeps the nodes from running.
pub fn run_nodes(
    context: &Context,
    store: Store,
    run: &RunRecord,
    nodes: &[AddedNode],
) -> Result<DerivedRun, Error> {
    let names: Vec<String> = nodes.iter().map(|node| node.name.clone()).collect();
    let mut given = GlobalOptions {
        device: context.config.device.clone(),
        ..GlobalOptions::default()
    };
    let tree = {
        let lineage = Lineage::of(&store, run.clone())?;
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
    let name = format!("{}{EXPORTS}", run.pipeline.trim_end_matches(EXPORTS));
    let text = json!(tree).to_string();
    let session = Session::derived(context, Loaded { pipeline, text }, name, store)?;
    let options = Options {
        to: names,
        ..options(&session)
    };
    let record = execute(&session, &options)?.done()?;
    for name in made_otherwise(run, &record) {
        context.warn(format!(
            "this marf makes `{name}` in another way than run {}, and made it again: what is written is of the new result",
            run.number
        ));
    }
    Ok(DerivedRun { session, record })
}

/// Returns the nodes whose results are others than those of a run before, and were to be: a stage has another version since.
fn made_otherwise<'r>(before: &RunRecord, after: &'r RunRecord) -> Vec<&'r str> {
    let is_other = |node: &&NodeRun| {
        let old = before.node(&node.name).filter(|old| old.state.is_good());
        old.is_some_and(|old| old.key != node.key && old.outputs != node.outputs)
    };
    let good = after
        .nodes
        .iter()
        .filter(|node| node.parent.is_none() && node.state.is_good());
    good.filter(is_other).map(|node| node.name.as_str()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;

    /// A run of one training: what it was keyed by and what it gave.
    fn run(key: &str, weights: &str) -> RunRecord {
        let [key, weights] = [key, weights].map(|text| Digest::of(text.as_bytes()));
        let node = json!({
            "name": "train", "stage": "train", "parent": null, "edges": [], "key": key, "state": "finished", "reason": "",
            "seconds": 1.0, "outputs": {"weights.safetensors": {"digest": weights, "bytes": 1}}, "counts": {},
        });
        let run = json!({
            "pipeline": "p", "command": "", "program": "", "started_unix_s": 0, "seconds": 1.0, "outcome": "done",
            "digest": key, "threads": 1, "nodes": [node], "latest": {},
        });
        serde_json::from_value(run).unwrap()
    }

    #[test]
    fn a_node_is_told_that_was_keyed_otherwise_and_gave_something_else() {
        let before = run("version 11", "a");
        assert_eq!(made_otherwise(&before, &run("version 12", "b")), ["train"]);
        for same in [
            run("version 11", "a"),
            run("version 12", "a"),
            run("version 11", "b"),
        ] {
            assert!(made_otherwise(&before, &same).is_empty());
        }
    }
}
