//! Why an action was not computed.

use marf_cache::{Digest, StoreError};

use crate::{check::GraphError, record::EngineError};

/// Why an action was not computed.
#[derive(Debug, thiserror::Error)]
pub enum ActionError {
    /// No stage of this program has the name.
    #[error("stage `{stage}`, which this program does not have")]
    NoStage {
        /// Its name.
        stage: String,
    },
    /// The action is of a part of a node.
    #[error("part `{part}` of stage `{stage}`, which this program computes only with its node")]
    Part {
        /// Name of the stage.
        stage: String,
        /// Name of the part.
        part: String,
    },
    /// The stage reads an archive, which the machine that plans does.
    #[error("stage `{stage}`, which reads an archive, where the run was planned")]
    Source {
        /// Name of the stage.
        stage: String,
    },
    /// The stage refuses the parameters.
    #[error("stage `{stage}`: {message}")]
    Params {
        /// Name of the stage.
        stage: String,
        /// Which, and why.
        message: String,
    },
    /// The action wants another backend than this machine has.
    #[error("stage `{stage}` on {wanted}, and here is {here}")]
    Backend {
        /// Name of the stage.
        stage: String,
        /// The backend of the action.
        wanted: String,
        /// The backend that this machine would use.
        here: String,
    },
    /// This program makes another key of the action.
    #[error("stage `{stage}` of another marf: {difference}. This program would give it the key {key}", key = key.short())]
    Key {
        /// Name of the stage.
        stage: String,
        /// The first difference.
        difference: String,
        /// The key that this program makes.
        key: Digest,
    },
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
