//! `marf bench`: figures about this program, measured on the machine at hand.

mod args;
mod child;
mod effort;
mod engine;
mod explain;
#[cfg(unix)]
mod faults;
mod items;
mod line;
mod pace;
mod photos;
mod pictures;
mod table1;
mod train;

use marf_engine::Cancel;

use super::args::Global;
use super::error::CliError;

pub use args::BenchVerb;

/// Five nodes of a pipeline behind an archive `photos`, with thresholds that small photos pass.
const FIVE_NODES: &str = include_str!("five_nodes.toml");

/// Runs a verb of `bench`.
///
/// # Errors
/// Those of the verb.
pub fn bench(global: &Global, verb: &BenchVerb, cancel: &Cancel) -> Result<(), CliError> {
    match verb {
        BenchVerb::Train(args) => train::train(global, args, cancel),
        BenchVerb::Engine(args) => engine::engine(global, args, cancel),
        BenchVerb::Items(args) => items::items(global, args, cancel),
        BenchVerb::Table1(args) => table1::table1(global, args, cancel),
        #[cfg(unix)]
        BenchVerb::Faults(args) => faults::faults(args, cancel),
    }
}
