//! Options of all benchmarks.

use clap::Args;
use marf_field::Device;
use marf_run::Context;

/// Options of all benchmarks.
#[derive(Debug, Clone, Args)]
pub struct Global {
    /// Pipeline file
    #[arg(
        short,
        long,
        global = true,
        value_name = "FILE",
        default_value = "pipeline.toml"
    )]
    pub file: std::path::PathBuf,
    /// Folder of the store [default: .marf next to the pipeline file]
    #[arg(long, global = true, value_name = "DIR")]
    pub store: Option<std::path::PathBuf>,
    /// Override a value, e.g. `train.scale=2`
    #[arg(long = "set", global = true, value_name = "NODE.KEY=VALUE")]
    pub sets: Vec<String>,
    /// Number of CPU cores to use [default: all]
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<std::num::NonZero<usize>>,
    /// Device for training: `auto` (a GPU if there is one), `cpu`, `gpu` or `gpu:NAME`
    #[arg(long, global = true, value_name = "DEVICE")]
    pub device: Option<Device>,
    /// Print JSON to stdout
    #[arg(long, global = true)]
    pub json: bool,
}

impl Global {
    /// Returns the context of a benchmark.
    pub fn context(&self, context: Context) -> Context {
        let mut context = Context {
            file: self.file.clone(),
            store: self.store.clone(),
            sets: self.sets.clone(),
            threads: self.threads,
            ..context
        };
        context.config.device.clone_from(&self.device);
        context
    }
}
