//! Eight programs at once on one new store.

use std::process::Child;

use super::case::{Case, Variant};
use super::injector::{Injector, Outcome, RoundError};
use super::lab::Lab;

/// Programs at once.
pub const PROGRAMS: usize = 8;
/// What each of them works with.
pub const THREADS: [&str; 2] = ["--threads", "1"];

/// Starts programs on new stores.
pub struct Eight<'a> {
    pub lab: &'a Lab,
    pub case: Case,
}

impl Injector for Eight<'_> {
    fn prepare(&mut self, _round: u32) -> Outcome {
        self.lab.reset(&self.case)
    }

    fn inject(&mut self, _round: u32) -> Outcome {
        let started = (0..PROGRAMS).map(|_| self.case.start(Variant::Plain, &THREADS));
        let runs: Vec<Outcome<Child>> = started.collect();
        let mut outcome = Ok(());
        for run in runs {
            let status = run?.wait()?;
            if !status.success() {
                outcome = Err(RoundError::Bad(format!("one of {PROGRAMS} runs: {status}")));
            }
        }
        outcome
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.lab.ends_equal(&self.case, Variant::Plain)?;
        self.lab.is_whole(&self.case)
    }

    fn detail(&self) -> String {
        format!("{PROGRAMS} programs on one new store, then one more")
    }
}
