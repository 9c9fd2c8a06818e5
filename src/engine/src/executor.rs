//! Results that other machines compute.

use std::fmt;

use marf_cache::{Action, Digest, Store};
use marf_stage::{Cancel, Progress, Stage, StageError, Work};

use crate::needs::Needs;

/// Has actions computed on other machines.
pub trait Executor: fmt::Debug + Send + Sync {
    /// Returns what computes the nodes of a stage, if it takes these: their keys hold the backend of that machine.
    fn machine_of(&self, stage: &str) -> Option<Machine<'_>>;

    /// Tells whether it takes an action; what it does not take is computed here.
    fn takes(&self, action: &Action) -> bool;

    /// Returns the most actions that it takes at once, at least 1.
    fn slots(&self) -> usize;

    /// Has an action computed, and puts its record and all that this consists of into the store.
    ///
    /// # Errors
    /// What kept the other machine from computing it; [`StageError::Cancelled`] if the user wants to stop.
    fn execute(&self, order: &Order<'_>) -> Result<(), StageError>;

    /// Tells whether it takes parts of a node that measure so many photos; what it does not take is computed here.
    fn takes_parts(&self, action: &Action, photos: u64) -> bool;

    /// Has parts of a node computed, and puts their records and all that these consist of into the store. `order` is of the
    /// node.
    ///
    /// # Errors
    /// As [`Executor::execute`]; parts that were computed by then may be in the store.
    fn execute_parts(&self, order: &Order<'_>, parts: &[PartOrder]) -> Result<(), StageError>;
}

/// What of another machine decides which backend a stage has there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Machine<'a> {
    /// The backend id of its GPU; none of a machine without one.
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
        // Of all others at most parts are computed elsewhere, and these have no backend.
        Work::Set(_) => executor.and_then(|executor| executor.machine_of(name)),
        _ => None,
    };
    match machine {
        Some(machine) => stage.backend_id_on(machine.gpu),
        None => Ok(stage.backend_id()),
    }
}

/// A part of a node to compute elsewhere.
#[derive(Debug, Clone)]
pub struct PartOrder {
    /// The key of its result.
    pub key: Digest,
    /// The bytes of its action, which are not in the store.
    pub action: Vec<u8>,
    /// How many photos it is about.
    pub photos: u64,
}

/// Other machines that compute a node or parts of it.
pub(crate) struct OtherMachines<'a> {
    pub(crate) executor: &'a dyn Executor,
    pub(crate) needs: Needs,
    /// Keys of the results of the run so far, sorted.
    pub(crate) results: Vec<Digest>,
}

/// An action to compute elsewhere, with what travels beside it and is in no key.
pub struct Order<'a> {
    /// Name of the node.
    pub node: &'a str,
    /// The key of the result.
    pub key: Digest,
    /// The action, whose bytes are in the store under the key.
    pub action: &'a Action,
    /// What it needs of a machine.
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
