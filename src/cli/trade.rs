//! `marf trade`: measures what each parameter costs in time and gains in quality, on this machine.

use std::path::PathBuf;

use clap::Args;
use marf_engine::document;
use marf_run::trade::TradeRequest;
use marf_run::{Context, Error};

use super::options::PipelineArgs;
use super::output::print_json;
use crate::terminal::{eprint_line, print_line};

/// Arguments of `trade`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct TradeArgs {
    /// Folder with photos, as for `marf fit`, instead of the pipeline
    pub dir: Option<PathBuf>,
    /// Vary only these parameters, e.g. `train.scale`
    #[arg(long = "knob", value_name = "NODE.KEY")]
    pub knobs: Vec<String>,
    /// Number of seeds that every point is trained with
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=100))]
    pub seeds: u64,
    /// Number of additional points with random values of all parameters
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=10_000))]
    pub random: u64,
    /// Additional point with these values, e.g. `train.steps=4000 train.scale=2`
    #[arg(long = "point", value_name = "SETTINGS")]
    pub points: Vec<String>,
    /// Optimiser steps of the base point, instead of the pipeline's
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Folder for trade.json, trade.csv, front.svg, effects.svg and report.html
    #[arg(long, value_name = "DIR", default_value = "out/trade")]
    pub out: PathBuf,
    /// Print one JSON document to stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pipeline: PipelineArgs,
}

const AFTER_HELP: &str = "\
Every point is a training of the pipeline with other values, and its result is kept in the store. A trade that was stopped continues, \
and more seeds, parameters or points can be added later. `[trade]` in pipeline.toml lists the parameters and their values, e.g. \
`\"train.scale\" = [1, 2, 3]`. The default is values around those of the pipeline. Times are wall time: run nothing else meanwhile.";

/// Runs `marf trade`.
pub fn trade(args: TradeArgs, context: Context) -> Result<(), Error> {
    let request = TradeRequest {
        dir: args.dir,
        knobs: args.knobs,
        seeds: args.seeds,
        random: args.random,
        points: args.points,
        steps: args.steps,
        out: args.out,
    };
    let trade = marf_run::trade::trade(&args.pipeline.context(context), &request)?;
    if args.json {
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
