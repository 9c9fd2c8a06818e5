//! Runs that are stopped at random moments, by SIGKILL or by Ctrl-C.

use std::os::unix::process::ExitStatusExt as _;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::case::{Case, Variant, files_of};
use super::injector::{Fault, Injector, Outcome, RoundError};
use super::lab::Lab;

/// A run that was asked to stop must have ended after this time.
const LIMIT: Duration = Duration::from_secs(2);

/// Number of the signal of Ctrl-C.
const SIGINT: i32 = 2;

/// Stops runs of one store until one comes to its end, then of the next.
pub struct Stop<'a> {
    lab: &'a Lab,
    fault: Fault,
    case: Case,
    /// Time that a run of a new store takes, as last seen: the machine may do other work too.
    span: Duration,
    /// Random moments so far.
    moments: u32,
    /// Whether no run of the store was stopped yet.
    is_new: bool,
    /// Stores whose run came to its end.
    finished: u32,
    /// Stops that left downloads behind, half or whole, that no result held yet.
    in_download: u32,
    longest: Duration,
}

impl<'a> Stop<'a> {
    /// Makes the first store.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn new(lab: &'a Lab, case: Case, fault: Fault) -> Outcome<Self> {
        lab.reset(&case)?;
        Ok(Self {
            lab,
            fault,
            case,
            span: lab.wall,
            moments: 0,
            is_new: true,
            finished: 0,
            in_download: 0,
            longest: Duration::ZERO,
        })
    }

    fn is_killing(&self) -> bool {
        matches!(self.fault, Fault::Kill | Fault::FetchKill)
    }

    /// Compares the digests of a store whose run came to its end, and makes the next.
    fn next_store(&mut self) -> Outcome {
        self.finished += 1;
        self.lab.ends_equal(&self.case, Variant::Plain)?;
        self.lab.is_whole(&self.case)?;
        self.is_new = true;
        self.lab.reset(&self.case)
    }

    /// Returns a run that is still running at a random moment. Stores whose run ended before it are judged.
    fn run_in_the_middle(&mut self) -> Outcome<Child> {
        loop {
            self.moments += 1;
            let random = self.lab.random(self.fault, self.moments);
            let after = Duration::from_micros(random % (self.span.as_micros() as u64).max(1));
            let began = Instant::now();
            let mut run = self.case.start(Variant::Plain, &[])?;
            if !ended_within(&mut run, after)? {
                self.is_new = false;
                return Ok(run);
            }
            if self.is_new {
                self.span = began.elapsed();
            }
            self.next_store()?;
        }
    }

    fn interrupt(&mut self, mut run: Child) -> Outcome {
        let asked = Instant::now();
        let kill = ["-c", &format!("kill -INT {}", run.id())];
        Command::new("sh").args(kill).stderr(Stdio::null()).status()?;
        let status = run.wait()?;
        let took = asked.elapsed();
        self.longest = self.longest.max(took);
        // Exit code 0 is that of a run that had just ended. A run that had just begun ends by the signal
        // itself.
        let is_stopped = matches!(status.code(), Some(0 | 130)) || status.signal() == Some(SIGINT);
        if is_stopped && took <= LIMIT {
            Ok(())
        } else {
            Err(RoundError::Bad(format!("it took {took:?}: {status}")))
        }
    }
}

impl Injector for Stop<'_> {
    fn inject(&mut self, _round: u32) -> Outcome {
        let mut run = self.run_in_the_middle()?;
        if self.is_killing() {
            run.kill()?;
            run.wait()?;
            return Ok(());
        }
        self.interrupt(run)
    }

    fn judge(&mut self, _round: u32) -> Outcome {
        let downloads = self.case.store().join("scratch/downloads");
        self.in_download += u32::from(!files_of(&downloads).is_empty());
        self.lab.is_whole(&self.case)
    }

    fn finish(&mut self) -> Outcome {
        self.next_store()
    }

    fn detail(&self) -> String {
        let finished = self.finished;
        let stores = format!("{finished} stores, each verified after each stop and run to its end");
        let how = if self.is_killing() {
            "SIGKILL".to_owned()
        } else {
            format!("SIGINT (longest stop {:.2} s)", self.longest.as_secs_f64())
        };
        let downloads = if self.fault.needs_server() {
            format!(", {} in mid-download", self.in_download)
        } else {
            String::new()
        };
        format!("{how} at random moments{downloads}, {stores}")
    }
}

/// Waits for a run for at most `after`. Returns whether it has ended.
fn ended_within(run: &mut Child, after: Duration) -> Outcome<bool> {
    let began = Instant::now();
    loop {
        if run.try_wait()?.is_some() {
            return Ok(true);
        }
        if began.elapsed() >= after {
            return Ok(false);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}
