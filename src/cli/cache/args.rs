//! The arguments of `marf cache`.

use std::time::Duration;

use clap::{Args, Subcommand};
use marf_cache::ReadShare;
use marf_run::Error;

use crate::cli::options::{RecordArgs, SignArg, StoreArgs};

/// Verbs of `cache`.
#[derive(Debug, Clone, Subcommand)]
pub enum CacheVerb {
    /// Count objects, bytes, records and runs, and results by stage
    Stat(RecordArgs),
    /// Remove data that no kept run, pin, lock file or running program needs
    Gc(GcArgs),
    /// Verify the stored data
    Fsck(FsckArgs),
    /// Send a run and its results to a shared store
    Push(PushArgs),
    /// Fetch a run and its results from a shared store
    Pull(PullArgs),
    /// Protect the results of a run from `gc`
    Pin {
        /// Name of the pin
        name: String,
        /// Number of the run [default: the newest whole one]
        run: Option<u64>,
        #[command(flatten)]
        store: StoreArgs,
    },
    /// Remove a pin
    Unpin {
        /// Name of the pin
        name: String,
        #[command(flatten)]
        store: StoreArgs,
    },
}

/// Arguments of `cache gc`.
#[derive(Debug, Clone, Args)]
pub struct GcArgs {
    /// Number of runs to keep for each pipeline, always including the newest
    #[arg(long, value_name = "RUNS", default_value_t = 10)]
    pub keep_last: usize,
    /// Remove older runs until the rest fits, e.g. `20GB`
    #[arg(long, value_name = "SIZE")]
    pub max_size: Option<String>,
    /// Keep data that was stored or used within this time
    #[arg(long, value_name = "TIME", default_value = "24h")]
    pub grace: String,
    /// Only print what would be removed
    #[arg(long)]
    pub dry_run: bool,
    /// Clean a shared store instead: that of the pipeline, or this one
    #[arg(long, value_name = "URL", conflicts_with = "max_size")]
    pub remote: Option<Option<String>>,
    #[command(flatten)]
    pub record: RecordArgs,
}

/// Arguments of `cache push`.
#[derive(Debug, Clone, Args)]
pub struct PushArgs {
    /// Number of the run [default: the newest whole one]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Address of the shared store, `s3://BUCKET/PREFIX` or `file:///FOLDER`, with credentials from the environment (`AWS_*`) [default:
    /// `[store] remote` of the pipeline]
    #[arg(long, value_name = "URL")]
    pub remote: Option<String>,
    #[command(flatten)]
    pub record: RecordArgs,
    #[command(flatten)]
    pub sign: SignArg,
}

/// Arguments of `cache pull`.
#[derive(Debug, Clone, Args)]
pub struct PullArgs {
    /// First digits of the run, as printed by a push [default: the newest of this pipeline]
    #[arg(long, value_name = "DIGITS")]
    pub run: Option<String>,
    /// Address of the shared store, `s3://BUCKET/PREFIX` or `file:///FOLDER`, with credentials from the environment (`AWS_*`) [default:
    /// `[store] remote` of the pipeline]
    #[arg(long, value_name = "URL")]
    pub remote: Option<String>,
    #[command(flatten)]
    pub record: RecordArgs,
}

/// Arguments of `cache fsck`.
#[derive(Debug, Clone, Args)]
pub struct FsckArgs {
    /// Read the bytes, and compare digests: of everything, or of a random share such as 5%
    #[arg(long, value_name = "SHARE", num_args = 0..=1, require_equals = true, default_missing_value = "100%", value_parser = share)]
    pub read_data: Option<ReadShare>,
    /// Quarantine damaged files and rebuild the index. In a shared store, remove damaged files and everything that refers to them
    #[arg(long)]
    pub repair: bool,
    /// Verify a shared store instead: that of the pipeline, or this one
    #[arg(long, value_name = "URL")]
    pub remote: Option<Option<String>>,
    #[command(flatten)]
    pub record: RecordArgs,
}

/// Reads a share: `5%`.
fn share(text: &str) -> Result<ReadShare, String> {
    let percent = text
        .strip_suffix('%')
        .and_then(|number| number.parse::<f64>().ok());
    match percent {
        Some(100.0) => Ok(ReadShare::ALL),
        Some(percent) if percent > 0.0 && percent < 100.0 => Ok(ReadShare::sample(percent / 100.0)),
        _ => Err("write a share above 0% and up to 100%, such as 5%".to_owned()),
    }
}

impl GcArgs {
    /// Reads the time to keep: `24h`, `30m`, `0s`.
    ///
    /// # Errors
    /// A text that is not a time.
    pub fn grace(&self) -> Result<Duration, Error> {
        let text = &self.grace;
        humantime::parse_duration(text)
            .map_err(|error| Error::usage(format!("--grace {text}: {error}. Write a time, such as 24h")))
    }
}
