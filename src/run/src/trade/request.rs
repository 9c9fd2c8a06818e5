//! Measures what each knob costs in time and gains in quality, on this machine.

use std::path::{Path, PathBuf};

use marf_cache::file::{FileKind, Links, read_text};
use marf_engine::{Options, SilentListener, document};
use marf_progress::format;
use marf_report::trade::{Point, Trade};
use marf_report::trade_page;

use super::base::Base;
use super::figures::{self, figures};
use super::knobs::{self, Knob, knobs};
use super::measured::measure;
use crate::context::Context;
use crate::error::Error;
use crate::execute::{Extras, execute_with, options};
use crate::session::Session;
use crate::{documents, files, program, report};

/// A trade to measure.
#[derive(Debug, Clone)]
pub struct TradeRequest {
    /// A folder with photos instead of the pipeline.
    pub dir: Option<PathBuf>,
    /// Turn only these knobs. Empty for all.
    pub knobs: Vec<String>,
    /// Seeds of the pipeline as it is and of every point with one knob turned.
    pub seeds: u64,
    /// Further points with every knob at a random one of its values.
    pub random: u64,
    /// Further points with these settings, separated by spaces.
    pub points: Vec<String>,
    /// Optimiser steps of the training as it is, instead of the pipeline's.
    pub steps: Option<u64>,
    /// Folder to write.
    pub out: PathBuf,
}

/// Measures a trade, and writes its table, drawings and report.
///
/// # Errors
/// A pipeline without a training, or one that cannot be trained as it is.
pub fn trade(context: &Context, request: &TradeRequest) -> Result<Trade, Error> {
    let steps = request.steps.map(|steps| format!("train.steps={steps}"));
    let base = Base::new(context, request.dir.clone(), steps.into_iter().collect())?;
    let first = first_point(&base, request)?;
    let session = base.open(&base.sets)?;
    let knobs = knobs(&session, &base, &request.knobs)?;
    let mut points = vec![first];
    points.extend(one_at_a_time(&knobs));
    let with_seeds = points.len();
    points.extend(knobs::random(&knobs, request.random));
    points.extend(request.points.iter().map(|settings| Point {
        sets: settings.split_whitespace().map(str::to_owned).collect(),
        ..Point::default()
    }));
    let count = points.len() - 1;
    let seconds = points[0].means().map_or(0.0, |(_, seconds)| seconds);
    let trainings = (with_seeds as u64 - 1) * request.seeds + (points.len() - with_seeds) as u64;
    context.feedback.note(&format!(
        "{}, {}: about {} if all take as long as the first",
        format::count(count, "point"),
        format::count(trainings as usize, "training"),
        format::duration(trainings as f64 * seconds)
    ));
    for (index, point) in points.iter_mut().enumerate().skip(1) {
        context
            .feedback
            .note(&format!("point {index} of {count}: {}", point.name()));
        measure(&base, point, if index < with_seeds { request.seeds } else { 1 })?;
    }
    let trade = figures(&session.name, &machine(context), program::PROGRAM, points);
    write(&session, &base, &trade, &request.out)?;
    Ok(trade)
}

/// Measures the pipeline as it is.
fn first_point(base: &Base, request: &TradeRequest) -> Result<Point, Error> {
    let mut first = Point::default();
    measure(base, &mut first, request.seeds)?;
    if let Some(fault) = &first.fault {
        return Err(Error::failed(format!(
            "the pipeline cannot be trained as it is: {fault}"
        )));
    }
    Ok(first)
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
fn write(session: &Session, base: &Base, trade: &Trade, out: &Path) -> Result<(), Error> {
    let json = serde_json::to_vec_pretty(trade).map_err(|error| Error::failed(error.to_string()))?;
    let extras = Extras {
        documents: &|_| {
            Ok(documents::Documents::from([documents::put(
                session,
                document::TRADE,
                &json,
            )?]))
        },
        listener: &SilentListener,
    };
    let options = Options {
        to: vec![base.train.clone()],
        ..options(session)
    };
    let record = execute_with(session, &options, &extras)?.done()?;
    files::write(&out.join(document::TRADE), &json)?;
    let table = figures::csv(trade).map_err(|error| Error::failed(error.to_string()))?;
    files::write(&out.join("trade.csv"), &table)?;
    for (name, drawing) in [
        ("front.svg", trade_page::front(trade)),
        ("effects.svg", trade_page::effects(trade)),
    ] {
        files::write(&out.join(name), trade_page::file(&drawing).as_bytes())?;
    }
    files::write(
        &out.join(document::REPORT),
        report::page(session, &record)?.as_bytes(),
    )
}

/// Returns processor, cores and system.
fn machine(context: &Context) -> String {
    let known =
        read_text(Path::new("/proc/cpuinfo"), FileKind::Document, Links::Followed).unwrap_or_default();
    let model = known
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let model = model.map_or(std::env::consts::ARCH, |(_, model)| model.trim());
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let cores = context.threads.map_or(cores, std::num::NonZero::get);
    format!("{model}, {cores} cores, {}", std::env::consts::OS)
}
