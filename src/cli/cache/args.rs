//! The arguments of `marf cache`.

use clap::{Args, Subcommand};

/// Verbs of `cache`.
#[derive(Debug, Clone, Subcommand)]
pub enum CacheVerb {
    /// Count objects, bytes, records and runs, by stage too
    Stat,
    /// Remove what no kept run, no pin, no lock file and no running program needs
    Gc(GcArgs),
    /// Verify what is stored
    Fsck(FsckArgs),
    /// Keep the results of a run, whatever is collected
    Pin {
        /// Name of the pin
        name: String,
        /// Number of the run [default: the last one]
        run: Option<u64>,
    },
    /// Let a pinned run go with the others
    Unpin {
        /// Name of the pin
        name: String,
    },
    /// Make a store of marf 0.1.0 one of this version; nothing is fetched again
    Migrate {
        /// Only tell what would be kept and what must be made again
        #[arg(long)]
        dry_run: bool,
    },
}

/// Arguments of `cache gc`.
#[derive(Debug, Clone, Args)]
pub struct GcArgs {
    /// Runs of each pipeline whose results are kept; the last one always is
    #[arg(long, value_name = "RUNS", default_value_t = 10)]
    pub keep_last: usize,
    /// Give up older runs until what is kept fits, e.g. `20GB`
    #[arg(long, value_name = "SIZE")]
    pub max_size: Option<String>,
    /// Keep what was stored or used within this time
    #[arg(long, value_name = "TIME", default_value = "24h")]
    pub grace: String,
    /// Only tell what would be removed
    #[arg(long)]
    pub dry_run: bool,
}

/// Arguments of `cache fsck`.
#[derive(Debug, Clone, Copy, Args)]
pub struct FsckArgs {
    /// Read every byte and compare it with its digest
    #[arg(long)]
    pub read_data: bool,
    /// Set damaged files aside and make a wrong index anew
    #[arg(long)]
    pub repair: bool,
}
