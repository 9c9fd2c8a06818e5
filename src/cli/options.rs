//! Groups of options that several verbs have. A verb has those that it reads, and puts them into its [`Context`].

use std::num::NonZero;
use std::path::PathBuf;

use clap::Args;
use marf_field::Device;
use marf_run::Context;
use marf_run::scenes::Selection;
use marf_stage::Access;
use serde::de::DeserializeOwned;

/// Options of all verbs.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Global options")]
pub struct GlobalArgs {
    /// Change to this folder first
    #[arg(
        short = 'C',
        long = "directory",
        global = true,
        value_name = "DIR",
        default_value = "."
    )]
    pub directory: PathBuf,
}

/// The pipeline and its store.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Pipeline and store")]
pub struct StoreArgs {
    /// Pipeline file
    #[arg(short, long, value_name = "FILE", default_value = "pipeline.toml")]
    file: PathBuf,
    /// Folder of the store [default: .marf next to the pipeline file]
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
}

/// Values of nodes, and how their photos are read.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Values and photos")]
pub struct ValueArgs {
    /// Override a value, e.g. `blur.min_share=0.6` or `archive.demo.sols=1..=3`
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    sets: Vec<String>,
    /// Re-read every file of a folder, even if its size and mtime are unchanged
    #[arg(long)]
    rehash: bool,
}

/// Cores.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Computation")]
pub struct ThreadsArg {
    /// Number of CPU cores to use [default: all]; results do not depend on it
    #[arg(long, value_name = "N")]
    threads: Option<NonZero<usize>>,
}

/// The device of nodes that can run on several.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Computation")]
pub struct DeviceArg {
    /// Device for training and rendering: `auto` (a GPU if there is one), `cpu`, `gpu` or `gpu:NAME`; a node's own `device` takes
    /// precedence
    #[arg(long, value_name = "DEVICE")]
    device: Option<Device>,
}

/// What may be asked of archives on servers.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Archives on servers")]
pub struct AccessArgs {
    /// Fetch exactly the products that marf.lock lists; fail if their bytes differ
    #[arg(long)]
    locked: bool,
    /// Like --locked, but open no connection
    #[arg(long)]
    offline: bool,
}

/// Options of verbs that plan or run a pipeline.
#[derive(Debug, Clone, Args)]
pub struct PipelineArgs {
    #[command(flatten)]
    store: StoreArgs,
    #[command(flatten)]
    values: ValueArgs,
    #[command(flatten)]
    access: AccessArgs,
    #[command(flatten)]
    compute: ComputeArgs,
}

/// Options of verbs that run a pipeline of their own on the photos of a folder.
#[derive(Debug, Clone, Args)]
pub struct FolderArgs {
    /// Folder of the store [default: .marf]
    #[arg(long, value_name = "DIR", help_heading = "Pipeline and store")]
    store: Option<PathBuf>,
    #[command(flatten)]
    values: ValueArgs,
    #[command(flatten)]
    threads: ThreadsArg,
}

/// Options of verbs that compute something from the results of a run.
#[derive(Debug, Clone, Args)]
pub struct ResultArgs {
    #[command(flatten)]
    store: StoreArgs,
    #[command(flatten)]
    compute: ComputeArgs,
}

/// Cores and device.
#[derive(Debug, Clone, Args)]
pub struct ComputeArgs {
    #[command(flatten)]
    threads: ThreadsArg,
    #[command(flatten)]
    device: DeviceArg,
}

/// The form of the result.
#[derive(Debug, Clone, Copy, Args)]
pub struct JsonArg {
    /// Print one JSON document to stdout
    #[arg(long)]
    pub json: bool,
}

/// Which nodes.
#[derive(Debug, Clone, Default, Args)]
pub struct SelectionArgs {
    /// Run only this node and the nodes it depends on
    #[arg(long, value_name = "NODE")]
    to: Option<String>,
    /// Run only this node and the nodes that depend on it
    #[arg(long, value_name = "NODE")]
    from: Option<String>,
    /// Run only this scene, if the pipeline splits photos by place
    #[arg(long, value_name = "NAME")]
    scene: Option<String>,
}

impl From<SelectionArgs> for Selection {
    fn from(args: SelectionArgs) -> Self {
        Self {
            to: args.to,
            from: args.from,
            scene: args.scene,
        }
    }
}

impl StoreArgs {
    /// Returns the context of a verb that reads the results of a pipeline.
    pub fn context(self, context: Context) -> Context {
        Context {
            file: self.file,
            store: self.store,
            ..context
        }
    }
}

impl ValueArgs {
    /// Returns the context of a verb that runs nodes with other values.
    pub fn context(self, mut context: Context) -> Context {
        context.sets = self.sets;
        context.config.rehash = self.rehash;
        context
    }
}

impl ThreadsArg {
    /// Returns the context of a verb that computes on the CPU.
    pub fn context(self, context: Context) -> Context {
        Context {
            threads: self.threads,
            ..context
        }
    }
}

impl DeviceArg {
    /// Returns the context of a verb that trains or renders.
    pub fn context(self, mut context: Context) -> Context {
        context.config.device = self.device;
        context
    }
}

impl AccessArgs {
    fn context(self, mut context: Context) -> Context {
        context.config.access = if self.offline {
            Access::Offline
        } else if self.locked {
            Access::Locked
        } else {
            Access::Online
        };
        context
    }
}

impl ComputeArgs {
    fn context(self, context: Context) -> Context {
        self.device.context(self.threads.context(context))
    }
}

impl PipelineArgs {
    /// Returns the context of a verb that plans or runs a pipeline.
    pub fn context(self, context: Context) -> Context {
        let context = self.values.context(self.store.context(context));
        self.compute.context(self.access.context(context))
    }
}

impl FolderArgs {
    /// Returns the context of a verb on the photos of a folder.
    pub fn context(self, context: Context) -> Context {
        let store = self.store;
        let context = self.values.context(Context { store, ..context });
        self.threads.context(context)
    }
}

impl ResultArgs {
    /// Returns the context of a verb that computes something from the results of a run.
    pub fn context(self, context: Context) -> Context {
        self.compute.context(self.store.context(context))
    }
}

/// Reads a word as pipeline.toml has it.
///
/// # Errors
/// Names the words that are known.
pub fn word<T: DeserializeOwned>(word: &str) -> Result<T, String> {
    serde_json::from_value(word.into()).map_err(|error| error.to_string())
}
