//! `faults`: does to a small pipeline what disks, users and power cuts do, and compares every digest with those of an
//! undisturbed run.

mod case;
mod clock;
mod collect;
mod damage;
mod eight;
mod full;
mod injector;
mod lab;
mod limit;
mod namespace;
mod read_only;
mod source;
mod stop;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum as _};
use marf_engine::Cancel;
use serde::Serialize;

use crate::output::{Result, eprint_line, go_on, print_json};
use crate::process::{absent, marf};
use injector::{Fault, Injector, Outcome, RoundError};
use lab::Lab;
use source::Source;

/// Time between two lines of progress.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(10);

/// Arguments of `faults`.
#[derive(Debug, Clone, Args)]
pub struct FaultsArgs {
    /// Only these faults [default: all]
    #[arg(long, value_enum, value_delimiter = ',')]
    fault: Vec<Fault>,
    /// How often each is done
    #[arg(long, default_value_t = 200)]
    rounds: u32,
    /// Folder for the stores. It is removed afterwards unless a round ended badly
    #[arg(long, value_name = "DIR", default_value = "bench-faults")]
    dir: PathBuf,
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
    /// Description of the fault, in words.
    detail: String,
    wall_s: f64,
}

/// Does the faults and prints one JSON line each.
///
/// # Errors
/// Returns an error if a folder cannot be written, if a fault cannot be done here, with the way out, or if something was
/// wrong after a fault.
pub fn faults(args: &FaultsArgs, cancel: &Cancel) -> Result {
    marf()?; // before anything is written
    let dir = absent(&args.dir)?;
    let chosen = if args.fault.is_empty() {
        Fault::value_variants()
    } else {
        &args.fault
    };
    let (remote, local): (Vec<Fault>, Vec<Fault>) = chosen.iter().partition(|fault| fault.needs_server());
    let mut bad = 0;
    if !local.is_empty() {
        let source = Source::folder(&dir.join("local"))?;
        bad += rounds_of_faults(source, &dir.join("local"), &local, args.rounds, cancel)?;
    }
    if !remote.is_empty() {
        let source = Source::server()?;
        bad += rounds_of_faults(source, &dir.join("remote"), &remote, args.rounds, cancel)?;
    }
    if bad > 0 {
        return Err(format!("{bad} rounds ended badly").into());
    }
    Ok(std::fs::remove_dir_all(&dir)?)
}

/// Does some faults to the pipeline of a source, prints their reports, and returns how many rounds ended badly.
fn rounds_of_faults(
    source: Source,
    dir: &Path,
    faults: &[Fault],
    rounds: u32,
    cancel: &Cancel,
) -> Result<u32> {
    eprint_line("the undisturbed runs");
    let lab = Lab::new(dir, source)?;
    let mut bad = 0;
    for &fault in faults {
        let report = all_rounds(&lab, fault, rounds, cancel)?;
        print_json(&report)?;
        bad += report.bad;
    }
    Ok(bad)
}

/// Does all rounds of a fault.
fn all_rounds(lab: &Lab, fault: Fault, rounds: u32, cancel: &Cancel) -> Result<Report> {
    let began = Instant::now();
    let mut printed = began;
    let mut report = Report {
        fault: fault.word(),
        ..Report::default()
    };
    let mut injector = injector(lab, fault)?;
    for round in 0..rounds {
        go_on(cancel)?;
        let outcome = injector
            .prepare(round)
            .and_then(|()| injector.inject(round))
            .and_then(|()| injector.judge(round));
        report.rounds += 1;
        report.count(round, outcome)?;
        if printed.elapsed() >= PROGRESS_INTERVAL {
            printed = Instant::now();
            let Report { fault, bad, .. } = &report;
            eprint_line(&format!("{fault}: {} of {rounds} rounds, {bad} bad", round + 1));
        }
    }
    report.count(rounds, injector.finish())?;
    report.detail = injector.detail();
    report.wall_s = began.elapsed().as_secs_f64();
    Ok(report)
}

impl Report {
    /// Counts what ended badly.
    ///
    /// # Errors
    /// A fault that cannot be done here.
    fn count(&mut self, round: u32, outcome: Outcome) -> Result {
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
}

/// Returns the injector of a fault.
fn injector(lab: &Lab, fault: Fault) -> Outcome<Box<dyn Injector + '_>> {
    let case = lab.case(&fault.word());
    Ok(match fault {
        Fault::Kill | Fault::Interrupt | Fault::FetchKill | Fault::FetchInterrupt => {
            Box::new(stop::Stop::new(lab, case, fault)?)
        }
        Fault::Damage => Box::new(damage::Damage::new(lab, case)),
        Fault::Limit => Box::new(limit::Limit { lab, case, failed: 0 }),
        Fault::Full => Box::new(full::Full::new(lab, case)?),
        Fault::ReadOnly => Box::new(read_only::ReadOnly::new(lab, case)),
        Fault::Eight => Box::new(eight::Eight { lab, case }),
        Fault::Collect => Box::new(collect::Collect::new(lab, case)?),
        Fault::Clock => Box::new(clock::Clock { lab, case }),
    })
}
