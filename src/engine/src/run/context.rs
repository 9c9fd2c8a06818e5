//! Data that the scheduler and its jobs share.

use std::time::Instant;

use marf_cache::Store;
use marf_stage::Cancel;

use super::options::Options;
use crate::{
    executor::Executor, graph::Graph, record::RunRecord, shared::SharedResults, state_listener::StateListener,
};

/// Data that the scheduler and all jobs of a run share.
#[derive(Clone, Copy)]
pub(super) struct RunContext<'a> {
    pub(super) graph: &'a Graph,
    pub(super) store: &'a Store,
    pub(super) listener: &'a dyn StateListener,
    pub(super) cancel: &'a Cancel,
    /// The threads of the run, for listings.
    pub(super) pool: &'a rayon::ThreadPool,
    /// How to run, for records.
    pub(super) options: &'a Options,
    /// Computes results on other machines. None if all are computed here.
    pub(super) executor: Option<&'a dyn Executor>,
    /// The last run of the same pipeline.
    pub(super) last: Option<&'a RunRecord>,
    /// When the run began.
    pub(super) began: Instant,
    /// The same, in seconds since 1970.
    pub(super) started_unix_s: u64,
    /// Where results are shared with other machines.
    pub(super) shared: Option<&'a dyn SharedResults>,
}
