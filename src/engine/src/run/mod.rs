//! The run: nodes are looked up by key, and executed where the store has no result.

mod context;
mod job;
mod prepare;
mod recover;
mod report;
mod scheduler;
mod select;
mod state;
mod task;

use std::{num::NonZero, thread, time::Instant};

use marf_cache::Store;
use marf_stage::Cancel;

use self::{context::RunContext, job::unix_seconds, scheduler::Scheduler, state::RunState};
use crate::{
    event::Listener,
    graph::Graph,
    record::{EngineError, RunRecord, last_run},
};

/// How to run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Threads to use; none for as many as there are cores.
    pub threads: Option<NonZero<usize>>,
    /// Run only these nodes and what they depend on; empty for all.
    pub to: Vec<String>,
    /// Run only these nodes and what depends on them; empty for all.
    pub from: Vec<String>,
    /// Name of the pipeline: a run is compared with the last run of the same name.
    pub pipeline: String,
    /// The command as typed, for the record.
    pub command: String,
    /// The program with version and commit, for the record.
    pub program: String,
}

/// Runs a graph: every node whose key is not in the store, in parallel as far as threads allow.
///
/// Returns the record, which is in the store by then, also of a run in which nodes failed or which was stopped.
/// A failed node stops only the nodes that depend on it; what was computed stays.
///
/// # Errors
/// A name in `to` or `from` that is not in the graph; a store that cannot be used.
pub fn run(
    graph: &Graph,
    store: &Store,
    options: &Options,
    listener: &dyn Listener,
    cancel: &Cancel,
) -> Result<RunRecord, EngineError> {
    let (began, started_unix_s) = (Instant::now(), unix_seconds());
    let last = last_run(store, &options.pipeline)?;
    let roles = select::roles(graph, &options.to, &options.from)?;
    let cores = || thread::available_parallelism().map_or(1, NonZero::get);
    let threads = options.threads.map_or_else(cores, NonZero::get);
    let context = RunContext {
        graph,
        store,
        listener,
        cancel,
        program: &options.program,
        last: last.as_ref(),
    };
    let state = Scheduler::new(RunState::new(context, roles), threads).run()?;
    let nodes = report::node_runs(&state)?;
    let mut latest = last.as_ref().map(|run| run.latest.clone()).unwrap_or_default();
    let good = nodes.iter().filter(|node| node.state.is_good());
    latest.extend(good.filter_map(|node| Some((node.name.clone(), node.key?))));
    let record = RunRecord {
        number: 0,
        pipeline: options.pipeline.clone(),
        command: options.command.clone(),
        program: options.program.clone(),
        started_unix_s,
        seconds: began.elapsed().as_secs_f64(),
        outcome: report::outcome(&state),
        digest: graph.digest(),
        threads,
        nodes,
        latest,
    };
    record.store(store)
}
