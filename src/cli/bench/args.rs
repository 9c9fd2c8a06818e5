//! The arguments of `marf bench`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

#[cfg(unix)]
use super::faults::FaultsArgs;

/// Verbs of `bench`.
#[derive(Debug, Clone, Subcommand)]
pub enum BenchVerb {
    /// Train on a folder's photos for so many seconds and score the test views: one JSON line a budget
    Train(TrainArgs),
    /// Print Table 1 of the MaRF paper for a folder's photos or a pipeline, beside the paper's
    Table1(super::table1::Table1Args),
    /// Make a synthetic archive and run folder, filters and store on it: cold, without a change, with new sols; one JSON
    /// line a phase
    Engine(EngineArgs),
    /// Run engine, store and two filters on rows without photos: what a million items cost when nothing changes; one JSON
    /// line a phase
    Items(ItemsArgs),
    /// Kill, stop, damage and starve runs of a small pipeline, and compare every digest; one JSON line a fault
    #[cfg(unix)]
    Faults(FaultsArgs),
}

/// Arguments of `bench engine`.
#[derive(Debug, Clone, Args)]
pub struct EngineArgs {
    /// Photos
    #[arg(long, default_value_t = 10_000)]
    pub photos: u64,
    /// Sols they are spread over
    #[arg(long, default_value_t = 1_000)]
    pub sols: u32,
    /// Sols that are added later
    #[arg(long, value_name = "SOLS", default_value_t = 10)]
    pub new_sols: u32,
    /// Width of a photo in pixels, a multiple of 16; 160 makes files of about 12 KB
    #[arg(long, value_name = "PX", default_value_t = 160, value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub width: u32,
    /// Share of photos that are too small, empty, or copies
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    pub flawed: f64,
    /// How often all is done, each time in a folder of its own
    #[arg(long, default_value_t = 3)]
    pub rounds: u32,
    /// Folder for photos and stores
    #[arg(long, value_name = "DIR", default_value = "bench-engine")]
    pub dir: PathBuf,
    /// Let the sols arrive one by one, with a run after each: one JSON line a sol
    #[arg(long)]
    pub daily: bool,
    /// Leave photos and stores there
    #[arg(long)]
    pub keep: bool,
}

/// Arguments of `bench items`.
#[derive(Debug, Clone, Args)]
pub struct ItemsArgs {
    /// Rows
    #[arg(long, default_value_t = 1_000_000)]
    pub items: u64,
    /// Sols they are spread over
    #[arg(long, default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..))]
    pub sols: u32,
    /// How often the run without a change is repeated
    #[arg(long, default_value_t = 3)]
    pub rounds: u32,
    /// Folder of the store
    #[arg(long, value_name = "DIR", default_value = "bench-items")]
    pub dir: PathBuf,
    /// Run one phase in this program, and print its nodes
    #[arg(long, value_enum, hide = true)]
    pub phase: Option<ItemsPhase>,
}

/// Phases of `bench items`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ItemsPhase {
    /// All sols
    All,
    /// One sol more
    OneMore,
}

impl ItemsPhase {
    /// Returns the word of the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::OneMore => "one-more",
        }
    }
}

/// Arguments of `bench train`; `--set train.field.KEY=VALUE` and `--set train.seed=N` count too.
#[derive(Debug, Clone, Args)]
pub struct TrainArgs {
    /// A folder with images/ and a transforms.json that names train_filenames and test_filenames
    pub dir: PathBuf,
    /// Seconds of training, ascending; the paper's table has `10,60,300,600,900`
    #[arg(
        long,
        value_name = "SECONDS",
        default_value = "10,60,300",
        value_delimiter = ','
    )]
    pub seconds: Vec<String>,
    /// Steps instead of seconds, ascending: the same weights every time, to compare keys of the field
    #[arg(long, value_name = "STEPS", value_delimiter = ',', conflicts_with = "seconds")]
    pub steps: Vec<u64>,
    /// Folder for `<seconds>s/<name>.png` or `<steps>steps/<name>.png`
    #[arg(long, value_name = "DIR", default_value = "bench")]
    pub out: PathBuf,
    /// What counts as time
    #[arg(long, value_enum, default_value_t = Clock::Wall)]
    pub clock: Clock,
    /// Tell where the error is: photos trained on beside those held out, after an affine fit, by scale, by distance
    #[arg(long)]
    pub explain: bool,
}

/// Clocks of `bench`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Clock {
    /// Wall clock, as the comparison asks
    Wall,
    /// Processor time over the number of threads, for a machine that does other work too
    Cpu,
}
