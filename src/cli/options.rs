//! Groups of options that several verbs have. A verb has those that it reads, and puts them into its [`Context`].

use std::num::NonZero;
use std::path::{Path, PathBuf};

use clap::Args;
use marf_config::nearest::near_word;
use marf_field::Device;
use marf_run::scenes::Selection;
use marf_run::{Context, Signing};
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

/// Cores.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Computation")]
pub struct ThreadsArg {
    /// Number of CPU cores to use, which does not affect results [default: all]
    #[arg(long, value_name = "N")]
    threads: Option<NonZero<usize>>,
}

/// Signatures of results.
#[derive(Debug, Clone, Copy, Args)]
#[command(next_help_heading = "Shared store")]
pub struct SignArg {
    /// Do not sign what is sent to a shared store. Without this option your key signs it, if you have one (`marf key new`)
    #[arg(long)]
    no_sign: bool,
}

/// The device of nodes that can run on several.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Computation")]
pub struct DeviceArg {
    /// Device for training and rendering: `auto` (a GPU if there is one), `cpu`, `gpu` or `gpu:NAME`. A node's own `device` takes
    /// precedence
    #[arg(long, value_name = "DEVICE", value_parser = word::<Device>)]
    device: Option<Device>,
}

/// Values of nodes, and how their photos are read.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Nodes")]
pub struct NodeArgs {
    /// Override a value, e.g. `blur.min_share=0.6` or `archive.demo.sols=1..=3`
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    sets: Vec<String>,
    /// Re-read every file of a folder, even if its size and mtime are unchanged
    #[arg(long)]
    rehash: bool,
    #[command(flatten)]
    threads: ThreadsArg,
}

/// Options of verbs that print what the store has.
#[derive(Debug, Clone, Args)]
pub struct RecordArgs {
    /// Print one JSON document to stdout
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub store: StoreArgs,
}

/// Options of verbs that compute something from the results of a run.
#[derive(Debug, Clone, Args)]
pub struct ResultArgs {
    /// Print one JSON document to stdout
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    store: StoreArgs,
    #[command(flatten)]
    threads: ThreadsArg,
    #[command(flatten)]
    device: DeviceArg,
}

/// Options of verbs that run a pipeline of their own on the photos of a folder.
#[derive(Debug, Clone, Args)]
pub struct FolderArgs {
    /// Print one JSON document to stdout
    #[arg(long)]
    pub json: bool,
    /// Folder of the store [default: .marf]
    #[arg(long, value_name = "DIR")]
    store: Option<PathBuf>,
    #[command(flatten)]
    nodes: NodeArgs,
}

/// Options of verbs that plan or run a pipeline.
#[derive(Debug, Clone, Args)]
pub struct PipelineArgs {
    #[command(flatten)]
    store: StoreArgs,
    #[command(flatten)]
    nodes: NodeArgs,
    #[command(flatten)]
    device: DeviceArg,
    /// Fetch exactly the products that marf.lock lists, and fail if their bytes differ
    #[arg(long, help_heading = "Archives on servers")]
    locked: bool,
    /// Like --locked, but open no connection
    #[arg(long, help_heading = "Archives on servers")]
    offline: bool,
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

/// Returns the command line as a run records it: without the folders of this machine.
pub fn command(file: &Path) -> String {
    let words = std::env::args_os().skip(1);
    let words: Vec<String> = words.map(|word| word.to_string_lossy().into_owned()).collect();
    format!("marf {}", marf_engine::recorded_command(&words, file))
}

impl StoreArgs {
    /// Sets pipeline and store of a context.
    pub fn context(&self, context: Context) -> Context {
        Context {
            file: self.file.clone(),
            store: self.store.clone(),
            command: command(&self.file),
            ..context
        }
    }
}

impl ThreadsArg {
    /// Sets the number of cores of a context.
    pub fn context(&self, context: Context) -> Context {
        let threads = self.threads;
        Context { threads, ..context }
    }
}

impl SignArg {
    /// Sets whether results are signed.
    pub fn context(self, context: Context) -> Context {
        let signing = if self.no_sign {
            Signing::Off
        } else {
            Signing::OwnKey
        };
        Context { signing, ..context }
    }
}

impl DeviceArg {
    /// Sets the device of a context.
    pub fn context(&self, mut context: Context) -> Context {
        context.config.device.clone_from(&self.device);
        context
    }
}

impl NodeArgs {
    /// Sets values, cores, and how photos are read.
    pub fn context(&self, mut context: Context) -> Context {
        context.sets.clone_from(&self.sets);
        context.config.rehash = self.rehash;
        self.threads.context(context)
    }
}

impl ResultArgs {
    /// Sets all options of a context.
    pub fn context(&self, context: Context) -> Context {
        let context = self.threads.context(self.store.context(context));
        self.device.context(context)
    }
}

impl FolderArgs {
    /// Sets all options of a context.
    pub fn context(&self, context: Context) -> Context {
        let store = self.store.clone();
        self.nodes.context(Context { store, ..context })
    }
}

impl PipelineArgs {
    /// Sets all options of a context.
    pub fn context(&self, context: Context) -> Context {
        let mut context = self.nodes.context(self.store.context(context));
        context.config.access = match self {
            Self { offline: true, .. } => Access::Offline,
            Self { locked: true, .. } => Access::Locked,
            _ => Access::Online,
        };
        self.device.context(context)
    }
}

/// Reads a word as pipeline.toml has it.
///
/// # Errors
/// Names the words that are known, and the nearest.
pub fn word<T: DeserializeOwned>(word: &str) -> Result<T, String> {
    serde_json::from_value(word.into()).map_err(|error| {
        let message = error.to_string();
        match near_word(&message) {
            Some(hint) => format!("{message}, {hint}"),
            None => message,
        }
    })
}
