//! `marf bench faults`: does to a small pipeline what disks, users and power cuts do, and compares every digest with those of
//! an undisturbed run.

mod args;
mod case;
mod clock;
mod collect;
mod damage;
mod eight;
mod full;
mod lab;
mod limit;
mod namespace;
mod read_only;
mod source;
mod stop;

use std::path::Path;
use std::time::{Duration, Instant};

use clap::ValueEnum as _;
use marf_engine::Cancel;
use serde::Serialize;

use crate::terminal::{eprint_line, print_line};
use args::Fault;
use lab::Lab;
use marf_run::Error;
use source::Source;
use stop::{Signal, Stop};

pub use args::FaultsArgs;

/// Time between two lines of progress.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(10);

/// Does a fault, one round after the other.
trait Injector {
    /// Makes what the round needs.
    fn prepare(&mut self, _round: u32) -> Outcome {
        Ok(())
    }

    /// Does the fault once; what the program does then and there is part of it.
    fn inject(&mut self, round: u32) -> Outcome;

    /// Checks what the round has left.
    fn judge(&mut self, round: u32) -> Outcome;

    /// Checks what all rounds have left.
    fn finish(&mut self) -> Outcome {
        Ok(())
    }

    /// Returns what was done, in words.
    fn detail(&self) -> String;
}

/// How a step of a round ended.
type Outcome = Result<(), RoundError>;

/// Why a round did not end well.
#[derive(Debug)]
enum RoundError {
    /// The program did what it should not.
    Bad(String),
    /// The fault cannot be done here.
    Impossible(Error),
}

impl From<Error> for RoundError {
    fn from(error: Error) -> Self {
        Self::Impossible(error)
    }
}

impl From<std::io::Error> for RoundError {
    fn from(error: std::io::Error) -> Self {
        Self::Impossible(Error::failed(error.to_string()))
    }
}

/// The result of one kind of fault.
#[derive(Debug, Default, Serialize)]
struct Report {
    fault: String,
    rounds: u32,
    /// Rounds after which a digest differed, a check failed, or a run did not end well.
    bad: u32,
    /// The first of them, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_bad: Option<String>,
    /// What was done, in words.
    detail: String,
    wall_s: f64,
}

/// Runs `marf bench faults`: one JSON line a fault.
///
/// # Errors
/// A folder that cannot be written; a fault that cannot be done here, with the way out; a fault after which something was
/// wrong.
pub fn faults(args: &FaultsArgs, cancel: &Cancel) -> Result<(), Error> {
    let dir = std::path::absolute(&args.dir).unwrap_or_else(|_| args.dir.clone());
    if dir.exists() {
        return Err(Error::usage(format!(
            "{} is there already; remove it or name another folder with --dir",
            dir.display()
        )));
    }
    let chosen = if args.fault.is_empty() {
        Fault::value_variants()
    } else {
        &args.fault
    };
    let (remote, local): (Vec<Fault>, Vec<Fault>) = chosen.iter().partition(|fault| fault.needs_server());
    let mut bad = 0;
    if !local.is_empty() {
        let lab = dir.join("local");
        bad += of_source(Source::folder(&lab)?, &lab, &local, args, cancel)?;
    }
    if !remote.is_empty() {
        bad += of_source(Source::server()?, &dir.join("remote"), &remote, args, cancel)?;
    }
    match bad {
        0 => remove(&dir),
        _ => Err(Error::failed(format!("{bad} rounds ended badly"))),
    }
}

/// Does some faults to the pipeline of a source, prints their reports, and returns how many rounds ended badly.
fn of_source(
    source: Source,
    dir: &Path,
    faults: &[Fault],
    args: &FaultsArgs,
    cancel: &Cancel,
) -> Result<u32, Error> {
    eprint_line("the undisturbed runs");
    let lab = Lab::new(dir, args.seed, source)?;
    let mut bad = 0;
    for &fault in faults {
        let report = all_rounds(&lab, fault, args.rounds, cancel)?;
        print_line(&serde_json::to_string(&report).map_err(|error| Error::failed(error.to_string()))?);
        bad += report.bad;
    }
    Ok(bad)
}

/// Does all rounds of a fault.
fn all_rounds(lab: &Lab, fault: Fault, rounds: u32, cancel: &Cancel) -> Result<Report, Error> {
    let began = Instant::now();
    let mut told = began;
    let mut report = Report {
        fault: fault.word(),
        ..Report::default()
    };
    let mut injector = injector(lab, fault)?;
    for round in 0..rounds {
        if cancel.is_set() {
            return Err(Error::Interrupted);
        }
        let outcome = injector
            .prepare(round)
            .and_then(|()| injector.inject(round))
            .and_then(|()| injector.judge(round));
        report.rounds += 1;
        report.count(round, outcome)?;
        if told.elapsed() >= PROGRESS_INTERVAL {
            told = Instant::now();
            eprint_line(&report.progress(rounds));
        }
    }
    let outcome = injector.finish();
    report.count(rounds, outcome)?;
    report.detail = injector.detail();
    report.wall_s = began.elapsed().as_secs_f64();
    Ok(report)
}

impl Report {
    /// Counts what ended badly.
    ///
    /// # Errors
    /// A fault that cannot be done here.
    fn count(&mut self, round: u32, outcome: Outcome) -> Result<(), Error> {
        match outcome {
            Ok(()) => Ok(()),
            Err(RoundError::Impossible(error)) => Err(error),
            Err(RoundError::Bad(what)) => {
                let what = format!("round {round}: {what}");
                eprint_line(&format!("bad: {}: {what}", self.fault));
                self.bad += 1;
                self.first_bad.get_or_insert(what);
                Ok(())
            }
        }
    }

    fn progress(&self, rounds: u32) -> String {
        format!(
            "{}: {} of {rounds} rounds, {} bad",
            self.fault, self.rounds, self.bad
        )
    }
}

/// Returns what does a fault.
fn injector<'a>(lab: &'a Lab, fault: Fault) -> Result<Box<dyn Injector + 'a>, Error> {
    Ok(match fault {
        Fault::Kill | Fault::FetchKill => Box::new(Stop::new(lab, fault, Signal::Kill)?),
        Fault::Interrupt | Fault::FetchInterrupt => Box::new(Stop::new(lab, fault, Signal::Interrupt)?),
        Fault::Damage => Box::new(damage::Damage::new(lab)),
        Fault::Limit => Box::new(limit::Limit::new(lab)),
        Fault::Full => Box::new(full::Full::new(lab)?),
        Fault::ReadOnly => Box::new(read_only::ReadOnly::new(lab)),
        Fault::Eight => Box::new(eight::Eight::new(lab)),
        Fault::Collect => Box::new(collect::Collect::new(lab)?),
        Fault::Clock => Box::new(clock::Clock::new(lab)),
    })
}

fn remove(dir: &Path) -> Result<(), Error> {
    std::fs::remove_dir_all(dir)
        .map_err(|error| Error::failed(format!("cannot remove {}: {error}", dir.display())))
}
