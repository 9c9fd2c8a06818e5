//! Options of all verbs.

use std::num::NonZero;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use marf_config::GlobalOptions;
use marf_engine::Cancel;
use marf_field::Device;
use marf_run::Context;
use marf_stage::Access;

use super::feedback::Terminal;

/// Options of all verbs.
#[derive(Debug, Clone, Args)]
pub struct Global {
    /// Change to this folder first
    #[arg(
        short = 'C',
        long = "directory",
        global = true,
        value_name = "DIR",
        default_value = "."
    )]
    pub directory: PathBuf,
    /// The pipeline file
    #[arg(
        short,
        long,
        global = true,
        value_name = "FILE",
        default_value = "pipeline.toml"
    )]
    pub file: PathBuf,
    /// Folder of the store [default: .marf beside the pipeline]
    #[arg(long, global = true, value_name = "DIR")]
    pub store: Option<PathBuf>,
    /// Override a value of the pipeline, e.g. `blur.min_share=0.6` or `archive.demo.sols=1..=3`
    #[arg(long = "set", global = true, value_name = "NODE.KEY=VALUE")]
    pub sets: Vec<String>,
    /// Cores to use [default: all]; results do not depend on it
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<NonZero<usize>>,
    /// Device that trains and renders: `auto` (a GPU, if there is one), `cpu`, `gpu` or `gpu:NAME`; a node's own `device`
    /// has priority
    #[arg(long, global = true, value_name = "DEVICE")]
    pub device: Option<Device>,
    /// Use exactly the products of archives on servers that marf.lock lists; fail where their bytes differ
    #[arg(long, global = true)]
    pub locked: bool,
    /// Like --locked, and open no connection
    #[arg(long, global = true)]
    pub offline: bool,
    /// Read the bytes of all files of folders, also of those whose size and times have not changed
    #[arg(long, global = true)]
    pub rehash: bool,
    /// Print JSON to stdout
    #[arg(long, global = true)]
    pub json: bool,
}

impl Global {
    /// Returns what these options say to a request.
    pub fn context(&self, cancel: &Cancel) -> Context {
        let words = std::env::args_os().skip(1);
        let words: Vec<String> = words.map(|word| word.to_string_lossy().into_owned()).collect();
        let terminal = if self.json {
            Terminal::with_json_lines()
        } else {
            Terminal::with_progress()
        };
        Context {
            file: self.file.clone(),
            store: self.store.clone(),
            sets: self.sets.clone(),
            threads: self.threads,
            config: self.config(),
            command: format!("marf {}", marf_engine::recorded_command(&words, &self.file)),
            commit: option_env!("MARF_COMMIT"),
            feedback: Arc::new(terminal),
            cancel: cancel.clone(),
        }
    }

    /// Returns the options that hold for all nodes and archives.
    fn config(&self) -> GlobalOptions {
        let access = if self.offline {
            Access::Offline
        } else if self.locked {
            Access::Locked
        } else {
            Access::Online
        };
        GlobalOptions {
            device: self.device.clone(),
            access,
            rehash: self.rehash,
            ..GlobalOptions::default()
        }
    }
}
