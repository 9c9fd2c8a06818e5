//! The arguments of `marf cache`.

use std::time::Duration;

use clap::{Args, Subcommand};
use marf_run::Error;

/// Verbs of `cache`.
#[derive(Debug, Clone, Subcommand)]
pub enum CacheVerb {
    /// Count objects, bytes, records and runs, by stage too
    Stat,
    /// Remove what no kept run, no pin, no lock file and no running program needs
    Gc(GcArgs),
    /// Verify what is stored
    Fsck(FsckArgs),
    /// Send a run with all its results to a shared store
    Push(PushArgs),
    /// Fetch a run with all its results from a shared store
    Pull(PullArgs),
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
    /// Collect a shared store in place of the own: that of the pipeline, or this one
    #[arg(long, value_name = "URL", conflicts_with = "max_size")]
    pub remote: Option<Option<String>>,
}

/// Arguments of `cache push`.
#[derive(Debug, Clone, Args)]
pub struct PushArgs {
    /// Number of the run [default: the last one]
    #[arg(long)]
    pub run: Option<u64>,
    /// Address of the shared store, `s3://BUCKET/PREFIX` or `file:///FOLDER` [default: `[store] remote` of the pipeline];
    /// credentials come from the environment (`AWS_*`)
    #[arg(long, value_name = "URL")]
    pub remote: Option<String>,
}

/// Arguments of `cache pull`.
#[derive(Debug, Clone, Args)]
pub struct PullArgs {
    /// First digits of the run, as a push tells them [default: the newest of this pipeline]
    #[arg(long, value_name = "DIGITS")]
    pub run: Option<String>,
    /// Address of the shared store, `s3://BUCKET/PREFIX` or `file:///FOLDER` [default: `[store] remote` of the pipeline];
    /// credentials come from the environment (`AWS_*`)
    #[arg(long, value_name = "URL")]
    pub remote: Option<String>,
}

/// Arguments of `cache fsck`.
#[derive(Debug, Clone, Args)]
pub struct FsckArgs {
    /// Read every byte and compare it with its digest
    #[arg(long)]
    pub read_data: bool,
    /// Set damaged files aside and make a wrong index anew; of a shared store remove them with what names them
    #[arg(long)]
    pub repair: bool,
    /// Verify a shared store in place of the own: that of the pipeline, or this one
    #[arg(long, value_name = "URL")]
    pub remote: Option<Option<String>>,
}

impl GcArgs {
    /// Reads the time to keep: `24h`, `30m`, `0s`.
    ///
    /// # Errors
    /// A text that is no time.
    pub fn grace(&self) -> Result<Duration, Error> {
        let text = &self.grace;
        humantime::parse_duration(text)
            .map_err(|error| Error::usage(format!("--grace {text}: {error}; write a time, such as 24h")))
    }
}
