//! How long computations are stopped and continued.

use std::time::Duration;

/// What a long computation asks of its caller. Invariant: no answer changes a result.
pub trait Supervisor: Sync {
    /// Returns whether to stop. Once true, it stays so.
    fn stop(&self) -> bool;

    /// Returns the time since something was saved.
    fn unsaved_for(&self) -> Duration {
        Duration::ZERO
    }

    /// Returns the last saved state of this name (letters, digits and `-`). `None` if it is missing or damaged.
    fn load(&self, _part: &str) -> Option<Vec<u8>> {
        None
    }

    /// Replaces the saved state of this name.
    fn save(&self, _part: &str, _state: &[u8]) {}
}

/// A supervisor that saves nothing.
impl<F: Fn() -> bool + Sync> Supervisor for F {
    fn stop(&self) -> bool {
        self()
    }
}

/// Wall clock after which the state of something unfinished is saved.
pub(crate) const SAVE_UNFINISHED: Duration = Duration::from_secs(10);
/// Wall clock after which something finished is saved: it is as large, but saved once.
pub(crate) const SAVE_FINISHED: Duration = Duration::from_secs(1);

#[cfg(test)]
pub(crate) mod testing {
    use std::collections::BTreeMap;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    /// Keeps saved states in memory, saves at every opportunity, and stops after a number of polls.
    #[derive(Default)]
    pub(crate) struct Stopping {
        parts: Mutex<BTreeMap<String, Vec<u8>>>,
        questions_left: AtomicU64,
    }

    impl Stopping {
        /// Stops after this many more polls.
        pub(crate) fn after(&self, questions: u64) -> &Self {
            self.questions_left.store(questions, Ordering::Relaxed);
            self
        }

        /// Returns the names of all parts.
        pub(crate) fn parts(&self) -> Vec<String> {
            self.parts.lock().unwrap().keys().cloned().collect()
        }

        /// Changes the bytes of every part.
        pub(crate) fn damage(&self, change: impl Fn(&mut Vec<u8>)) {
            self.parts.lock().unwrap().values_mut().for_each(change);
        }
    }

    impl Supervisor for Stopping {
        fn stop(&self) -> bool {
            let one_less = |left: u64| left.checked_sub(1);
            self.questions_left
                .fetch_update(Ordering::Relaxed, Ordering::Relaxed, one_less)
                .is_err()
        }

        fn unsaved_for(&self) -> Duration {
            Duration::MAX
        }

        fn load(&self, part: &str) -> Option<Vec<u8>> {
            self.parts.lock().unwrap().get(part).cloned()
        }

        fn save(&self, part: &str, state: &[u8]) {
            self.parts.lock().unwrap().insert(part.to_owned(), state.to_vec());
        }
    }
}
