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

use marf_run::{Context, Error};

use super::global::Global;

pub use args::BenchVerb;

/// Five nodes of a pipeline behind an archive `photos`, with thresholds that small photos pass.
const FIVE_NODES: &str = include_str!("five_nodes.toml");

/// Runs a verb of `bench`.
///
/// # Errors
/// Those of the verb.
pub fn bench(global: &Global, verb: &BenchVerb, context: &Context) -> Result<(), Error> {
    match verb {
        BenchVerb::Train(args) => train::train(args, context),
        BenchVerb::Engine(args) => engine::engine(global, args, &context.cancel),
        BenchVerb::Items(args) => items::items(global, args, &context.cancel),
        BenchVerb::Table1(args) => table1::table1(global, args, context),
        #[cfg(unix)]
        BenchVerb::Faults(args) => faults::faults(args, &context.cancel),
    }
}
