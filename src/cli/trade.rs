//! `marf trade`: what each knob costs in time and gains in quality, measured on this machine.

use std::path::PathBuf;

use clap::Args;
use marf_engine::document;
use marf_run::trade::TradeRequest;
use marf_run::{Context, Error};

use super::global::Global;
use super::output::print_json;
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
pub fn trade(global: &Global, args: TradeArgs, context: &Context) -> Result<(), Error> {
    let request = TradeRequest {
        dir: args.dir,
        knobs: args.knobs,
        seeds: args.seeds,
        random: args.random,
        points: args.points,
        steps: args.steps,
        truth: args.truth,
        out: args.out,
    };
    let trade = marf_run::trade::trade(context, &request)?;
    if global.json {
        return print_json(&trade);
    }
    trade
        .effects
        .iter()
        .for_each(|effect| print_line(&effect.sentence(&trade.points[effect.point])));
    let apart = trade
        .points
        .iter()
        .filter_map(|point| point.apart(trade.points.first()?));
    apart.for_each(|sentence| print_line(&sentence));
    eprint_line(&format!(
        "report: {}",
        request.out.join(document::REPORT).display()
    ));
    Ok(())
}
