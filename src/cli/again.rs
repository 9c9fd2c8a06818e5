//! Further nodes on the results of a run: nothing is fetched, and what the run made is reused.

use std::path::Path;

use marf_cache::Store;
use marf_engine::{Cancel, Options, RunRecord};
use marf_provenance::lineage::Lineage;
use marf_provenance::replay::recorded;
use serde_json::{Value, json};

use super::args::Global;
use super::error::{CliError, Diagnostic};
use super::replay::resolved;
use super::run::{execute, options};
use super::session::{EXPORTS, Session, TRADES, last_of, warn};
use crate::config::{GlobalOptions, check_tree};

/// Returns the last run, or the one of a number, in which a node ended well.
///
/// # Errors
/// No such run: names the nodes of the last one.
pub fn run_with(store: &Store, number: Option<u64>, node: &str) -> Result<RunRecord, CliError> {
    let has = |run: &RunRecord| run.node(node).is_some_and(|node| node.state.is_good());
    run_where(store, number, has, |run| without(run, node))
}

/// Returns the last run, or the one of a number, that has something; `without` is the error of a run that has it not. Points of a trade
/// are only taken by their number: their fields are not what the pipeline asks for.
///
/// # Errors
/// No such run.
pub fn run_where(
    store: &Store,
    number: Option<u64>,
    has: impl Fn(&RunRecord) -> bool,
    without: impl Fn(&RunRecord) -> CliError,
) -> Result<RunRecord, CliError> {
    if let Some(number) = number {
        let run = marf_engine::run_of(store, number)?;
        return if has(&run) { Ok(run) } else { Err(without(&run)) };
    }
    let runs = marf_engine::runs(store, warn)?;
    let is_asked_for = |run: &&RunRecord| !run.pipeline.ends_with(TRADES) && has(run);
    let last = runs.iter().rev().find(is_asked_for).cloned();
    let none = || match last_of(&runs) {
        Some(run) => without(run),
        None => CliError::Failed(Diagnostic::new("there is no run yet").hint("`marf run` makes one")),
    };
    last.ok_or_else(none)
}

/// Returns the error of a run in which a node did not end well, with the names of those that did.
pub fn without(run: &RunRecord, node: &str) -> CliError {
    let good = run
        .nodes
        .iter()
        .filter(|node| node.parent.is_none() && node.state.is_good());
    let known: Vec<&str> = good.map(|node| node.name.as_str()).collect();
    CliError::Usage(
        Diagnostic::new(format!("run {} has no result of a node `{node}`", run.number)).hint(format!(
            "its nodes are {}; or name another run with --run",
            known.join(", ")
        )),
    )
}

/// A node that is added to a run: its name and its table, as pipeline.toml would have it.
pub type Added<'a> = (&'a str, Value);

/// Runs more nodes on the results of a run, in its store. Archives are read as they were met then, so that nothing is asked of a
/// server, and every other node has its result already.
///
/// # Errors
/// A run of which something is lost; whatever keeps the nodes from running.
pub fn run_nodes(
    store: Store,
    run: &RunRecord,
    nodes: &[Added<'_>],
    global: &Global,
    cancel: &Cancel,
) -> Result<(Session, RunRecord), CliError> {
    let names: Vec<String> = nodes.iter().map(|(name, _)| (*name).to_owned()).collect();
    let (tree, given) = {
        let lineage = Lineage::of(&store, run.clone())?;
        let mut tree = resolved(&lineage)?;
        for (name, table) in nodes {
            tree["node"][*name] = table.clone();
        }
        let mut given = GlobalOptions {
            device: global.options().device,
            ..GlobalOptions::default()
        };
        for source in lineage
            .nodes
            .iter()
            .filter(|node| node.is_source() && node.run.state.is_good())
        {
            given
                .recorded
                .insert(source.run.name.clone(), recorded(&store, source)?);
        }
        (tree, given)
    };
    let pipeline = check_tree(&tree, &given, Path::new("")).map_err(|error| {
        CliError::Usage(Diagnostic {
            message: format!(
                "`{}` on run {}: {}",
                names.join("`, `"),
                run.number,
                error.message
            ),
            cause: None,
            hint: error.hint,
        })
    })?;
    let of = format!("{}{EXPORTS}", run.pipeline.trim_end_matches(EXPORTS));
    let session = Session::again(pipeline, json!(tree).to_string(), of, store, cancel)?;
    let options = Options {
        to: names,
        ..options(global, &session.name)
    };
    let (record, ended) = execute(&session, &options, global, cancel)?;
    ended?;
    Ok((session, record))
}
