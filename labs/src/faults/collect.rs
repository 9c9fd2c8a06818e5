//! Collections of garbage, with no grace and one run to keep, during eight runs of two pipelines.

use std::process::Child;

use super::case::{Case, Variant, is_success};
use super::eight::{PROGRAMS, THREADS};
use super::injector::{Injector, Outcome, RoundError};
use super::lab::Lab;

/// Exit code of a collection that another one kept from its work.
const BUSY: i32 = 11;

/// Collects while runs come and go.
pub struct Collect<'a> {
    lab: &'a Lab,
    case: Case,
    runs: Vec<Child>,
    /// How often eight runs were started.
    starts: u32,
}

impl<'a> Collect<'a> {
    /// Makes the store.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn new(lab: &'a Lab, case: Case) -> Outcome<Self> {
        lab.reset(&case)?;
        std::fs::create_dir_all(case.store())?;
        Ok(Self {
            lab,
            case,
            runs: Vec::new(),
            starts: 0,
        })
    }

    /// Forgets the runs that have ended.
    fn reap(&mut self) -> Outcome {
        let mut outcome = Ok(());
        let mut left = Vec::new();
        for mut run in self.runs.drain(..) {
            match run.try_wait()? {
                None => left.push(run),
                Some(status) if status.success() => {}
                Some(status) => {
                    outcome = Err(RoundError::Bad(format!("a run during a collection: {status}")));
                }
            }
        }
        self.runs = left;
        outcome
    }
}

impl Injector for Collect<'_> {
    fn prepare(&mut self, _round: u32) -> Outcome {
        if !self.runs.is_empty() {
            return Ok(());
        }
        self.starts += 1;
        for at in 0..PROGRAMS {
            let variant = [Variant::Plain, Variant::Changed][at % 2];
            self.runs.push(self.case.start(variant, &THREADS)?);
        }
        Ok(())
    }

    fn inject(&mut self, _round: u32) -> Outcome {
        let words = ["cache", "gc", "--keep-last", "1", "--grace", "0s"];
        let output = self.case.command(&words).output()?;
        match output.status.code() {
            Some(BUSY) => Ok(()),
            _ => is_success("gc", &output),
        }
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        self.reap()?;
        if !self.runs.is_empty() {
            return Ok(());
        }
        self.lab.ends_equal(&self.case, Variant::Plain)?;
        self.lab.is_whole(&self.case)
    }

    fn finish(&mut self) -> Outcome {
        for run in &mut self.runs {
            run.wait()?;
        }
        self.judge(0)
    }

    fn detail(&self) -> String {
        let starts = self.starts;
        format!("collections during {PROGRAMS} runs of two pipelines, which were started {starts} times")
    }
}
