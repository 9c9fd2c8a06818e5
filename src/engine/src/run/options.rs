//! How to run.

use std::{num::NonZero, sync::Arc, thread};

use crate::{executor::Executor, record::Build, shared::SharedResults, source::RunSource};

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

/// Returns the number of threads of a run. The default is the number of cores.
pub(crate) fn threads(wanted: Option<NonZero<usize>>) -> usize {
    let cores = || thread::available_parallelism().map_or(1, NonZero::get);
    wanted.map_or_else(cores, NonZero::get)
}
