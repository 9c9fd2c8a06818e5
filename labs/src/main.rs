//! The laboratory: benchmarks, fault programmes, and the truth of the built-in Mars. No part of the released program.

mod engine;
#[cfg(unix)]
mod faults;
mod items;
mod mars;
mod options;
mod output;
mod process;
mod stereo;
mod synthetic;
mod training;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use marf_engine::Cancel;

use output::Result;

/// Measure marf on this machine, break it on purpose, and compare it with the built-in Mars.
#[derive(Debug, Parser)]
#[command(
    name = "marf-labs",
    version,
    max_term_width = 100,
    arg_required_else_help = true
)]
struct Labs {
    #[command(subcommand)]
    program: Program,
}

/// Programs of the laboratory.
#[derive(Debug, Subcommand)]
enum Program {
    /// Train on a folder's photos for a number of seconds and score the test views: one JSON line a budget
    Train(training::TrainArgs),
    /// Make a synthetic archive and run folder, filters and store on it: cold, without a change, with new sols. Prints
    /// one JSON line a phase
    Engine(engine::EngineArgs),
    /// Run engine, store and two filters on rows without photos: the cost of a million items when nothing changes. Prints
    /// one JSON line a phase
    Items(items::ItemsArgs),
    /// Kill, stop, damage and starve runs of a small pipeline, and compare every digest. Prints one JSON line
    /// a fault
    #[cfg(unix)]
    Faults(faults::FaultsArgs),
    /// Match the pairs with true disparities of a folder, and print how many are right
    Stereo(stereo::StereoArgs),
    #[command(flatten)]
    Mars(mars::MarsProgram),
}

fn main() -> ExitCode {
    let labs = Labs::parse();
    let cancel = Cancel::default();
    let stop = cancel.clone();
    let ended = ctrlc::set_handler(move || stop.set())
        .map_err(Into::into)
        .and_then(|()| run(labs.program, &cancel));
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => output::print_error(error.as_ref()),
    }
}

fn run(program: Program, cancel: &Cancel) -> Result {
    match program {
        Program::Train(args) => training::train(&args, cancel),
        Program::Engine(args) => engine::engine(&args, cancel),
        Program::Items(args) => items::items(&args, cancel),
        #[cfg(unix)]
        Program::Faults(args) => faults::faults(&args, cancel),
        Program::Stereo(args) => stereo::stereo(&args, cancel),
        Program::Mars(program) => mars::run(program),
    }
}
