//! `marf trade`: what each knob costs in time and gains in quality, measured on this machine.

mod figures;
mod knobs;
mod measured;
mod truth;

use std::path::PathBuf;

use clap::Args;
use marf_engine::{Cancel, Options, document};
use serde_json::Value;

use self::figures::figures;
use self::knobs::{Knob, knobs};
use self::measured::{Base, measured};
use self::truth::Truth;
use super::args::Global;
use super::error::CliError;
use super::folder;
use super::output::print_json;
use super::run::{Execution, execute_as, options};
use super::session::{Session, TRADES};
use super::{documents, files, program, report, scenes};
use marf_report::trade::{self, Point, Trade};
use crate::terminal::{eprint_line, print_line};

/// Arguments of `trade`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct TradeArgs {
    /// A folder with photos, as `marf fit` takes it, instead of the pipeline
    pub dir: Option<PathBuf>,
    /// Turn only these knobs, e.g. `train.scale`
    #[arg(long = "knob", value_name = "NODE.KEY")]
    pub knobs: Vec<String>,
    /// Seeds, each a training of the pipeline as it is and of every point with one knob turned
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub seeds: u64,
    /// Further points with every knob at a random one of its values
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=10_000))]
    pub random: u64,
    /// A further point with these settings, e.g. `train.steps=4000 train.scale=2`
    #[arg(long = "point", value_name = "SETTINGS")]
    pub points: Vec<String>,
    /// Optimiser steps of the training as it is, instead of the pipeline's
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Known cameras of the photos, as transforms.json: what each point's calibration is off by is told
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Folder for trade.json, trade.csv, front.svg, effects.svg and report.html
    #[arg(long, value_name = "DIR", default_value = "out/trade")]
    pub out: PathBuf,
}

const AFTER_HELP: &str = "\
Every point is an ordinary training of the pipeline with other values, kept in its store: a trade that is stopped goes on, and \
more seeds, knobs or random points are added to what is known. `[trade]` in pipeline.toml sets the knobs and their values, \
`\"train.scale\" = [1, 2, 3]`; without it they stand around the values that the pipeline has. Let nothing else run meanwhile: \
seconds are those of the clock.";

/// Runs `marf trade`.
///
/// # Errors
/// A pipeline without a training, or one that cannot be trained as it is.
pub fn trade(global: &Global, args: &TradeArgs, cancel: &Cancel) -> Result<(), CliError> {
    let open = |sets: &[String]| -> Result<Session, CliError> {
        let global = Global {
            sets: [&global.sets, sets].concat(),
            ..global.clone()
        };
        let mut session = match &args.dir {
            Some(dir) => Session::implicit(&folder::training("trade", dir), &global, cancel)?,
            None => Session::open(&global, cancel)?,
        };
        session.name.push_str(TRADES);
        Ok(session)
    };
    let steps = args.steps.map(|steps| format!("train.steps={steps}"));
    let steps: Vec<String> = steps.into_iter().collect();
    let truth = args.truth.as_deref().map(Truth::read).transpose()?;
    let session = open(&steps)?;
    scenes::one(&session)?;
    let base = Base::of(&session, steps, truth.unwrap_or_default())?;
    drop(session);
    let mut points = vec![Point::default()];
    let measure = |point: &mut Point, seeds: u64| measured(&open, &base, point, seeds, global, cancel);
    measure(&mut points[0], args.seeds)?;
    if let Some(fault) = &points[0].fault {
        return Err(CliError::failed(format!(
            "the pipeline cannot be trained as it is: {fault}"
        )));
    }
    if let (Some(file), Some(run)) = (&args.truth, points[0].runs.first())
        && run.position_error.is_none()
    {
        return Err(CliError::usage(format!(
            "--truth {}: fewer than three of its cameras are of photos that were placed, or all of these stand on one line",
            file.display()
        )));
    }
    let session = open(&base.sets)?;
    let knobs = knobs(&session, &base, &args.knobs)?;
    points.extend(one_at_a_time(&knobs));
    let with_seeds = points.len();
    points.extend(knobs::random(&knobs, args.random));
    points.extend(args.points.iter().map(|settings| Point {
        sets: settings.split_whitespace().map(str::to_owned).collect(),
        ..Point::default()
    }));
    let count = points.len() - 1;
    let seconds = points[0].means().map_or(0.0, |(_, seconds)| seconds);
    let trainings = (with_seeds as u64 - 1) * args.seeds + (points.len() - with_seeds) as u64;
    eprint_line(&format!(
        "{count} points, {trainings} trainings: about {:.0} min if all took as long as the first",
        trainings as f64 * seconds / 60.0
    ));
    for (index, point) in points.iter_mut().enumerate().skip(1) {
        eprint_line(&format!("point {index} of {count}: {}", point.name()));
        measure(point, if index < with_seeds { args.seeds } else { 1 })?;
    }
    let trade = figures(
        session.name.trim_end_matches(TRADES),
        &machine(global),
        program::PROGRAM,
        points,
    );
    write((&session, &base), &trade, global, args, cancel)?;
    match global.json {
        true => print_json(&trade),
        false => {
            trade
                .effects
                .iter()
                .for_each(|effect| print_line(&effect.sentence(&trade.points[effect.point])));
            let apart = trade
                .points
                .iter()
                .filter_map(|point| point.apart(trade.points.first()?));
            apart.for_each(|sentence| print_line(&sentence));
            eprint_line(&format!("report: {}", args.out.join(document::REPORT).display()));
            Ok(())
        }
    }
}

fn one_at_a_time(knobs: &[Knob]) -> Vec<Point> {
    let turned = knobs
        .iter()
        .flat_map(|knob| knob.values.iter().map(|value| knob.set(value)));
    turned
        .map(|set| Point {
            sets: vec![set],
            ..Point::default()
        })
        .collect()
}

/// Keeps the trade as a document of a run that finds all its results, and writes it out.
fn write(
    (session, base): (&Session, &Base),
    trade: &Trade,
    global: &Global,
    args: &TradeArgs,
    cancel: &Cancel,
) -> Result<(), CliError> {
    let json = serde_json::to_vec_pretty(trade).map_err(|error| CliError::failed(error.to_string()))?;
    let execution = Execution {
        trace: None,
        documents: &|_| {
            Ok(documents::Documents::from([documents::put(
                session,
                document::TRADE,
                &json,
            )?]))
        },
    };
    let options = Options {
        to: vec![base.train.clone()],
        ..options(global, &session.name)
    };
    let (record, ended) = execute_as(session, &options, global, cancel, &execution)?;
    ended?;
    files::write(&args.out.join(document::TRADE), &json)?;
    let table = figures::csv(trade).map_err(|error| CliError::failed(error.to_string()))?;
    files::write(&args.out.join("trade.csv"), &table)?;
    for (name, drawing) in [
        ("front.svg", trade::front(trade)),
        ("effects.svg", trade::effects(trade)),
    ] {
        files::write(&args.out.join(name), trade::file(&drawing).as_bytes())?;
    }
    files::write(
        &args.out.join(document::REPORT),
        report::page(session, &record)?.as_bytes(),
    )
}

/// Returns processor, cores and system.
fn machine(global: &Global) -> String {
    let known = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = known
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let model = model.map_or(std::env::consts::ARCH, |(_, model)| model.trim());
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let cores = global.threads.map_or(cores, std::num::NonZero::get);
    format!("{model}, {cores} cores, {}", std::env::consts::OS)
}

/// Returns a value as the command line takes it after `=`.
fn as_toml(value: &Value) -> String {
    match toml::Value::try_from(value) {
        Ok(value) => value.to_string(),
        // JSON's `null` alone, which no list of values holds.
        Err(_) => String::new(),
    }
}
