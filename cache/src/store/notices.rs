//! Warnings of an open store to its caller, and the caller's request to end a wait.

use std::{
    collections::BTreeSet,
    time::{Duration, Instant},
};

use parking_lot::Mutex;

/// Pause between two attempts to take a lock.
const RETRY_INTERVAL: Duration = Duration::from_millis(2);

type Interrupt = Box<dyn Fn() -> bool + Send + Sync>;

/// Warnings for the caller, and the caller's wish to stop.
#[derive(Default)]
pub(super) struct Notices {
    warnings: Mutex<Vec<String>>,
    told: Mutex<BTreeSet<&'static str>>,
    interrupt: Option<Interrupt>,
}

impl Notices {
    /// Returns notices to a caller that can end waits.
    pub(super) fn to(interrupt: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self {
            interrupt: Some(Box::new(interrupt)),
            ..Self::default()
        }
    }

    /// Adds a warning.
    pub(super) fn warn(&self, text: String) {
        self.warnings.lock().push(text);
    }

    /// Adds a warning of this kind, unless one was added before.
    pub(super) fn warn_once(&self, kind: &'static str, text: impl FnOnce() -> String) {
        if self.told.lock().insert(kind) {
            self.warn(text());
        }
    }

    /// Returns the warnings since the last call.
    pub(super) fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.warnings.lock())
    }

    /// Returns whether waits should end.
    pub(super) fn is_interrupted(&self) -> bool {
        self.interrupt.as_ref().is_some_and(|interrupt| interrupt())
    }

    /// Tries until an attempt returns a value, `patience` ends or the caller interrupts. Returns the value, or the
    /// time waited in vain.
    pub(super) fn retry<T, E>(
        &self,
        patience: Duration,
        mut attempt: impl FnMut() -> Result<Option<T>, E>,
    ) -> Result<Result<T, Duration>, E> {
        let began = Instant::now();
        loop {
            if let Some(value) = attempt()? {
                return Ok(Ok(value));
            }
            if began.elapsed() >= patience || self.is_interrupted() {
                return Ok(Err(began.elapsed()));
            }
            std::thread::sleep(RETRY_INTERVAL);
        }
    }
}
