//! The run: nodes are looked up by key, and executed where the store has no result.

mod action;
mod context;
mod error;
mod job;
mod part;
mod prepare;
mod recover;
mod report;
mod scheduler;
mod select;
mod state;
mod task;

use std::{num::NonZero, sync::Arc, thread, time::Instant};

use marf_cache::Store;
use marf_stage::Cancel;

pub use self::{action::ActionJob, error::ActionError};
use self::{
    context::RunContext,
    job::{STACK_BYTES, unix_seconds},
    scheduler::Scheduler,
    state::RunState,
};
use crate::{
    event::{Event, Listener},
    executor::Executor,
    graph::Graph,
    record::{Build, EngineError, RunRecord, last_run},
    shared::SharedResults,
    source::RunSource,
    state_listener::{EventsOnly, StateListener},
};

/// How to run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Threads to use. None for as many as there are cores.
    pub threads: Option<NonZero<usize>>,
    /// Run only these nodes and the nodes they depend on. Empty for all.
    pub to: Vec<String>,
    /// Run only these nodes and the nodes that depend on them. Empty for all.
    pub from: Vec<String>,
    /// Nodes that have lost an object that their outputs refer to (a leaf of a set). They run although their results are recorded, and
    /// compute only the incomplete parts.
    pub lost: Vec<String>,
    /// Name of the pipeline: a run is compared with the last run of the same name and source.
    pub pipeline: String,
    /// The source of the run.
    pub source: RunSource,
    /// Name of this run, unique in its store: it is in all events.
    pub id: String,
    /// The command as typed, for the record.
    pub command: String,
    /// The program with its version, for the record.
    pub program: String,
    /// The program's file, for the record.
    pub build: Option<Build>,
    /// Computes results on other machines. None if all are computed here.
    pub executor: Option<Arc<dyn Executor>>,
    /// Shares results with other machines. None if they are not shared.
    pub shared: Option<Arc<dyn SharedResults>>,
}

/// Runs a graph as [`run_nodes`] and stores the record.
///
/// # Errors
/// As [`run_nodes`].
pub fn run(
    graph: &Graph,
    store: &Store,
    options: &Options,
    listener: &dyn Listener,
    cancel: &Cancel,
) -> Result<RunRecord, EngineError> {
    let warn = |message: String| listener.on_event(&Event::Warning { node: None, message });
    run_nodes(graph, store, options, &EventsOnly(listener), cancel)?.store(store, warn)
}

/// Runs a graph: every node whose key is not in the store, in parallel as far as threads allow.
///
/// Returns the record, also of a run in which nodes failed or which was stopped. It is not stored yet, so that documents can be added to it
/// ([`RunRecord::store`]). A failed node stops only the nodes that depend on it. Computed results are kept.
///
/// # Errors
/// A name in `to`, `from` or `lost` that is not in the graph, or a store that cannot be used.
pub fn run_nodes(
    graph: &Graph,
    store: &Store,
    options: &Options,
    listener: &dyn StateListener,
    cancel: &Cancel,
) -> Result<RunRecord, EngineError> {
    let (began, started_unix_s) = (Instant::now(), unix_seconds());
    let warn = |message: String| listener.on_event(&Event::Warning { node: None, message });
    let last = last_run(store, &options.pipeline, &options.source, warn)?;
    let roles = select::roles(graph, &options.to, &options.from)?;
    let lost = select::indices(graph, &options.lost)?;
    let threads = threads(options.threads);
    let pool = pool(threads)?;
    let context = RunContext {
        graph,
        store,
        listener,
        cancel,
        pool: &pool,
        options,
        last: last.as_ref(),
        executor: options.executor.as_deref(),
        began,
        started_unix_s,
        shared: options.shared.as_deref(),
    };
    let state = Scheduler::new(RunState::new(context, roles, &lost), threads).run()?;
    let record = report::record(&state)?;
    store.take_warnings().into_iter().for_each(warn);
    Ok(record)
}

/// Returns the number of threads of a run. The default is the number of cores.
pub(crate) fn threads(wanted: Option<NonZero<usize>>) -> usize {
    let cores = || thread::available_parallelism().map_or(1, NonZero::get);
    wanted.map_or_else(cores, NonZero::get)
}

/// Returns a pool of that many threads.
pub(crate) fn pool(threads: usize) -> Result<rayon::ThreadPool, EngineError> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .stack_size(STACK_BYTES)
        .build()
        .map_err(|error| EngineError::Threads {
            threads,
            message: error.to_string(),
        })
}
