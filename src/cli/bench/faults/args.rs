//! The arguments of `marf bench faults`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Arguments of `bench faults`.
#[derive(Debug, Clone, Args)]
pub struct FaultsArgs {
    /// Only these faults [default: all]
    #[arg(long, value_enum, value_delimiter = ',')]
    pub fault: Vec<Fault>,
    /// How often each is done
    #[arg(long, default_value_t = 200)]
    pub rounds: u32,
    /// Seed of the random moments and places
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Folder for the stores; it is removed afterwards unless a round ended badly
    #[arg(long, value_name = "DIR", default_value = "bench-faults")]
    pub dir: PathBuf,
}

/// Faults of `bench faults`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Fault {
    /// SIGKILL at random moments
    Kill,
    /// Ctrl-C at random moments
    Interrupt,
    /// SIGKILL while photos are fetched
    FetchKill,
    /// Ctrl-C while photos are fetched
    FetchInterrupt,
    /// A bit flipped, a cut, an emptying in every file of a store
    Damage,
    /// Files that may not grow beyond a limit
    Limit,
    /// A disk of 16 MB that runs full
    Full,
    /// A store that may not be written
    ReadOnly,
    /// Eight programs on one store
    Eight,
    /// Garbage collections beside eight programs
    Collect,
    /// File times far off
    Clock,
}

impl Fault {
    /// Returns whether photos are fetched from a server.
    pub fn needs_server(self) -> bool {
        matches!(self, Self::FetchKill | Self::FetchInterrupt)
    }

    /// Returns the word of the command line.
    pub fn word(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }
}
