//! Eight programs at once on one new store.

use std::process::Child;

use super::case::Case;
use super::lab::{Lab, Variant};
use super::{Injector, Outcome, RoundError};

/// Programs at once.
pub const PROGRAMS: usize = 8;
/// What each of them works with.
pub const THREADS: [&str; 2] = ["--threads", "1"];

/// Starts programs on new stores.
pub struct Eight<'a> {
    lab: &'a Lab,
    case: Case<'a>,
}

impl<'a> Eight<'a> {
    /// Makes nothing yet.
    pub fn new(lab: &'a Lab) -> Self {
        Self {
            lab,
            case: Case::at(lab, lab.dir.join("eight")),
        }
    }
}

impl Injector for Eight<'_> {
    fn prepare(&mut self, _round: u32) -> Outcome {
        self.case = self.lab.case("eight")?;
        Ok(())
    }

    fn inject(&mut self, _round: u32) -> Outcome {
        let started = (0..PROGRAMS).map(|_| self.case.start(Variant::Plain, &THREADS));
        let runs: Vec<Result<Child, RoundError>> = started.collect();
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
        self.case.ends_equal(Variant::Plain)?;
        self.case.is_whole()
    }

    fn detail(&self) -> String {
        format!("{PROGRAMS} programs on one new store, then one more")
    }
}
