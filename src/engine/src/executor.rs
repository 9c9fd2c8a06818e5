//! Results that other machines compute.

use std::fmt;

use marf_cache::{Action, Digest, Store};
use marf_stage::{Cancel, Progress, Stage, StageError, Work};

use crate::needs::Needs;

/// Has actions computed on other machines.
pub trait Executor: fmt::Debug + Send + Sync {
    /// Returns the machine that computes the nodes of a stage, if this executor takes them. Their keys hold the backend of that machine.
    fn machine_of(&self, stage: &str) -> Option<Machine<'_>>;

    /// Returns whether it takes an action. Other actions are computed here.
    fn takes(&self, action: &Action) -> bool;

    /// Returns the most actions that it takes at once, at least 1.
    fn slots(&self) -> usize;

    /// Has an action computed, and puts its record and every blob of it into the store.
    ///
    /// # Errors
    /// The error of the other machine, or [`StageError::Cancelled`] if the user wants to stop.
    fn execute(&self, order: &Order<'_>) -> Result<(), StageError>;
}

/// The properties of another machine that decide which backend a stage has there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Machine<'a> {
    /// The backend id of its GPU. None for a machine without one.
    pub gpu: Option<&'a str>,
}

/// Returns the backend of a stage where it is computed.
///
/// # Errors
/// It wants a device that the machine that computes it does not have.
pub(crate) fn backend_of(
    executor: Option<&dyn Executor>,
    name: &str,
    stage: &dyn Stage,
) -> Result<Option<String>, StageError> {
    let machine = match stage.work() {
        // All others are computed here.
        Work::Set(_) => executor.and_then(|executor| executor.machine_of(name)),
        _ => None,
    };
    match machine {
        Some(machine) => stage.backend_id_on(machine.gpu),
        None => Ok(stage.backend_id()),
    }
}

/// Other machines that compute a node.
pub(crate) struct OtherMachines<'a> {
    pub(crate) executor: &'a dyn Executor,
    pub(crate) needs: Needs,
    /// Keys of the results of the run so far, sorted.
    pub(crate) results: Vec<Digest>,
}

/// An action to compute elsewhere, with data that is sent with it and is not part of the key.
pub struct Order<'a> {
    /// Name of the node.
    pub node: &'a str,
    /// The key of the result.
    pub key: Digest,
    /// The action, whose bytes are in the store under the key.
    pub action: &'a Action,
    /// Its needs: cores, GPU, memory, time.
    pub needs: Needs,
    /// Keys of the results of the run so far, sorted: all that the action reads is an input, or belongs to one of these.
    pub results: &'a [Digest],
    /// The store of the run.
    pub store: &'a Store,
    /// Receives how far it is.
    pub progress: &'a dyn Progress,
    /// Whether the user wants to stop.
    pub cancel: &'a Cancel,
}
