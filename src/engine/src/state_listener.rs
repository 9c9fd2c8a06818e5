//! Receives the state of a run that goes on.

use crate::{
    event::{Event, Listener, SilentListener},
    record::RunRecord,
};

/// Receives the events of a run, and its state.
pub trait StateListener: Listener {
    /// Receives the run as it is, after each end of a node and at least once a second. `record` makes its record, which is not stored and
    /// takes time in proportion to the nodes. It is `None` if the store cannot be read. The scheduler waits for the return.
    fn on_state(&self, _record: &dyn Fn() -> Option<RunRecord>) {}
}

impl StateListener for SilentListener {}

/// Passes on events, and no states.
pub(crate) struct EventsOnly<'a>(pub(crate) &'a dyn Listener);

impl Listener for EventsOnly<'_> {
    fn on_event(&self, event: &Event) {
        self.0.on_event(event);
    }
}

impl StateListener for EventsOnly<'_> {}
