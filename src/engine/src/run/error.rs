//! Why an action was not computed.

use marf_cache::StoreError;

use crate::{check::GraphError, record::EngineError};

/// Why an action was not computed.
#[derive(Debug, thiserror::Error)]
pub enum ActionError {
    /// The stage reads an archive, which the machine that plans does.
    #[error("stage `{stage}`, which reads an archive, where the run was planned")]
    Source {
        /// Name of the stage.
        stage: String,
    },
    /// A part of a node, which is computed with its node.
    #[error("part `{part}` of stage `{stage}`, which this program computes only with its node")]
    Part {
        /// Name of the part.
        part: String,
        /// Name of the stage.
        stage: String,
    },
    /// This program on this machine computes something else, or nothing, under the key.
    #[error("{0}")]
    Elsewhere(String),
    /// The work failed. The listener got the cause.
    #[error("{0}")]
    Failed(String),
    /// The user wanted to stop.
    #[error("stopped")]
    Stopped,
    /// Threads, or a bad table of stages.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// A table of stages that no graph can have.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
}
