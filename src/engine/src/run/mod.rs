//! The run: nodes are looked up by key, and executed where the store has no result.

mod action;
mod context;
mod error;
mod job;
mod options;
mod prepare;
mod recover;
mod report;
mod scheduler;
mod select;
mod state;
mod task;

use std::time::Instant;

use marf_cache::Store;
use marf_stage::Cancel;

pub(crate) use self::options::threads;
pub use self::{action::ActionJob, error::ActionError, options::Options};
use self::{
    context::RunContext,
    job::{STACK_BYTES, unix_seconds},
    scheduler::Scheduler,
    state::RunState,
};
use crate::{
    event::{Event, Listener},
    graph::Graph,
    record::{EngineError, RunRecord, last_run},
    state_listener::{EventsOnly, StateListener},
};

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
