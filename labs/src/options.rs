//! Options and feedback of programs that train on the photos of a folder.

use std::num::NonZero;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use marf_config::GlobalOptions;
use marf_engine::{Cancel, SilentListener};
use marf_field::Device;
use marf_run::{Context, Feedback, RunFeedback, Signing};

use crate::output::eprint_line;

/// Options of trainings.
#[derive(Debug, Clone, Args)]
pub struct TrainingOptions {
    /// Override a value, e.g. `train.field.log2_table=14` or `train.seed=1`
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    pub sets: Vec<String>,
    /// Cores to use [default: all]
    #[arg(long, value_name = "N")]
    pub threads: Option<NonZero<usize>>,
    /// Device that trains and renders: `auto` (a GPU, if there is one), `cpu`, `gpu` or `gpu:NAME`
    #[arg(long, value_name = "DEVICE")]
    pub device: Option<Device>,
}

impl TrainingOptions {
    /// Returns the context of a request with these options.
    pub fn context(&self, cancel: &Cancel) -> Context {
        let words: Vec<String> = std::env::args().skip(1).collect();
        Context {
            file: PathBuf::new(),
            store: None,
            sets: self.sets.clone(),
            threads: self.threads,
            config: GlobalOptions {
                device: self.device.clone(),
                ..GlobalOptions::default()
            },
            command: format!("marf-labs {}", words.join(" ")),
            commit: None,
            signing: Signing::Off,
            feedback: Arc::new(Stderr),
            cancel: cancel.clone(),
        }
    }
}

/// Prints warnings and notes, and nothing of the progress of runs.
struct Stderr;

impl Feedback for Stderr {
    fn warn(&self, message: &str) {
        eprint_line(&format!("warning: {message}"));
    }

    fn note(&self, line: &str) {
        eprint_line(line);
    }

    fn follow(&self, _run: &str) -> Box<dyn RunFeedback> {
        Box::new(SilentListener)
    }
}
