//! The needs of a node on a machine. They are sent with the action and are not part of a key.

use marf_cache::RunMetadata;
use marf_stage::{Stage, Threads, Work};
use serde::Serialize;

/// Cores, GPU, memory and time of a node: the cores that its stage can use, and the memory and time of its last run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Needs {
    /// Cores that it can use. Fewer give the same result.
    pub cores: Threads,
    /// Whether it computes on a GPU.
    pub gpu: bool,
    /// Largest memory of the whole program up to the end of the node's last run, in MB. The node needs no more than this. Absent if it
    /// never ran, or if the system does not report it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory_mb: Option<u64>,
    /// Seconds that it took when it last ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

impl Needs {
    /// Returns the needs of a stage with its parameters. `gpu` is whether it computes on a GPU, `last` the metadata of the node's last run.
    pub(crate) fn new(stage: &dyn Stage, gpu: bool, last: Option<&RunMetadata>) -> Self {
        Self {
            cores: cores_of(stage),
            gpu,
            memory_mb: last.map(|last| last.peak_mb).filter(|peak| *peak > 0),
            seconds: last.map(|last| last.seconds),
        }
    }
}

/// Returns how many cores a stage can use.
pub(crate) fn cores_of(stage: &dyn Stage) -> Threads {
    match stage.work() {
        // These work item by item.
        Work::Map(_) | Work::Fold(_) | Work::Source(_) => Threads::All,
        Work::Set(_) | Work::Expand(_) => stage.threads(),
    }
}
