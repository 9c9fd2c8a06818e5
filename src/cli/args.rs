//! The command line, as clap reads it.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use marf_field::Device;
use marf_stage::Access;

use super::audit::AuditArgs;
use super::bench::BenchVerb;
use super::cache::CacheVerb;
use super::diff::DiffArgs;
use super::exec::ExecArgs;
use super::replay::ReplayArgs;
use marf_config::GlobalOptions;

/// Raw Mars rover and helicopter photos to radiance fields, with proof of how.
#[derive(Debug, Parser)]
#[command(
    name = "marf",
    version,
    about,
    max_term_width = 100,
    arg_required_else_help = true
)]
pub struct Cli {
    /// The verb.
    #[command(subcommand)]
    pub verb: Verb,
    /// Options of all verbs.
    #[command(flatten)]
    pub global: Global,
}

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
    /// Returns the options that hold for all nodes and archives.
    pub fn options(&self) -> GlobalOptions {
        let access = match (self.offline, self.locked) {
            (true, _) => Access::Offline,
            (false, true) => Access::Locked,
            (false, false) => Access::Online,
        };
        GlobalOptions {
            device: self.device.clone(),
            access,
            rehash: self.rehash,
            ..GlobalOptions::default()
        }
    }
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Run what changed, and write the report
    Run(RunArgs),
    /// Show which nodes would run, and the first thing that changed
    Plan(Selection),
    /// Show why a node would run, or the key of its result
    Why {
        /// The node
        node: String,
        /// Name every photo that was added, edited or removed
        #[arg(long)]
        files: bool,
    },
    /// Compute one action, its inputs from a shared store and its result into it: what a job of a batch system runs
    Exec(ExecArgs),
    /// Show the nodes of the last run
    Status,
    /// List the runs so far
    Log {
        /// How many, the newest first
        #[arg(short = 'n', long, default_value_t = 20)]
        last: usize,
    },
    /// Write a commented pipeline.toml
    Init {
        /// Which one
        #[arg(long, value_enum, default_value_t = Mission::Demo)]
        mission: Mission,
    },
    /// Print the JSON schema of pipeline.toml, for editors, or of the lines of `run --json`
    Schema {
        /// Of what
        #[arg(value_enum, default_value_t = SchemaOf::Pipeline)]
        of: SchemaOf,
    },
    /// Write report.html of the last run
    Report {
        /// Where to
        #[arg(long, value_name = "FILE", default_value = "report.html")]
        out: PathBuf,
    },
    /// Show the report live, with what runs now and a 3-D view of the field, on one local port
    View(super::view::ViewArgs),
    /// Render a trained field along a path: pictures of colour, depth or uncertainty, and a film
    Render(super::render::RenderArgs),
    /// Compare a place at two times: what changed on the ground, as maps with their uncertainty
    Compare(super::compare::CompareArgs),
    /// Hand a run, or what it made, to people and programs without the store
    Export {
        /// In which form
        #[command(subcommand)]
        verb: super::share::ExportVerb,
    },
    /// Check a crate or a signed statement, without a store
    Verify(super::share::VerifyArgs),
    /// Tell who made a file, from which bytes, or what a product went into
    Audit(AuditArgs),
    /// Make a run again in an empty store, from the bytes that it read, and compare all digests
    Replay(ReplayArgs),
    /// Tell what changed between two runs: parameters, products, metrics, pictures
    Diff(DiffArgs),
    /// Inspect the store
    Cache {
        /// What to do with it
        #[command(subcommand)]
        verb: CacheVerb,
    },
    /// Filter the photos of a folder, and show every verdict
    Filter(FilterArgs),
    /// Show what was read of every photo: format, size, the label's camera, site, drive and pose, sol
    Photos {
        /// A folder with photos [default: the last run of the pipeline]
        dir: Option<PathBuf>,
        /// The node whose photos are shown
        #[arg(long, default_value = "extract")]
        node: String,
    },
    /// Find the cameras of a folder's photos
    Calibrate(CalibrateArgs),
    /// Train a field on the photos of a folder, with the cameras beside them or by structure from motion, and render the held-out views
    Fit(FitArgs),
    /// Measure what each knob costs in time and gains in quality
    Trade(super::trade::TradeArgs),
    /// Benchmark this program
    Bench {
        /// What to measure
        #[command(subcommand)]
        verb: BenchVerb,
    },
    /// Write manual pages, one a verb
    Man {
        /// Folder to write
        dir: PathBuf,
    },
    /// Print completions for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// What `schema` prints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SchemaOf {
    /// pipeline.toml
    Pipeline,
    /// A line of `run --json`
    Events,
}

/// Which nodes.
#[derive(Debug, Clone, Default, Args)]
pub struct Selection {
    /// Only what leads to this node
    #[arg(long, value_name = "NODE")]
    pub to: Option<String>,
    /// Only this node and what follows from it
    #[arg(long, value_name = "NODE")]
    pub from: Option<String>,
    /// Only this scene, where the photos are split by place
    #[arg(long, value_name = "NAME")]
    pub scene: Option<String>,
}

/// Arguments of `run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    /// Which nodes
    #[command(flatten)]
    pub selection: Selection,
    /// Where pictures, models and the report go
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Write what ran when, for Perfetto or chrome://tracing
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Have trainings computed as jobs of a batch system: `slurm`, or others by `template` and `commands` of the site file
    #[arg(long, value_enum, value_name = "SYSTEM", hide_possible_values = true)]
    pub on: Option<BatchSystem>,
    /// The site file: shared store, folder of jobs, commands and limits of the batch system; in no key
    #[arg(long, value_name = "FILE", default_value = "site.toml")]
    pub site: PathBuf,
}

/// A batch system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum BatchSystem {
    /// Slurm, or what has its commands
    Slurm,
}

/// Arguments of `filter`.
#[derive(Debug, Clone, Args)]
pub struct FilterArgs {
    /// A folder with photos
    pub dir: PathBuf,
    /// CSV of file, verdict, score, threshold, twin, reason; a page with the photos goes beside it as .html
    #[arg(long, value_name = "FILE", default_value = "verdicts.csv")]
    pub out: PathBuf,
    /// Keep this photo (product id or file name), whatever the filters say
    #[arg(long, value_name = "ID")]
    pub keep: Vec<String>,
    /// Reject this photo, whatever the filters say
    #[arg(long, value_name = "ID")]
    pub reject: Vec<String>,
}

/// Arguments of `calibrate`.
#[derive(Debug, Clone, Args)]
pub struct CalibrateArgs {
    /// A folder with photos, and labels or cameras beside them
    pub dir: PathBuf,
    /// transforms.json to write, with the photos' paths as seen from it; metrics.json, sparse/0 (COLMAP's model, binary and text) and
    /// points.ply go beside it, and photos that are resampled
    #[arg(long, value_name = "FILE", default_value = "transforms.json")]
    pub out: PathBuf,
    /// Write photos without the distortion of their lens, as PNG
    #[arg(long)]
    pub undistort: bool,
    /// Where cameras come from
    #[arg(long, value_enum, default_value_t = Method::Sfm)]
    pub method: Method,
}

/// Arguments of `fit`.
#[derive(Debug, Clone, Args)]
pub struct FitArgs {
    /// A folder with photos; cameras are those of a transforms.json (nerfstudio, instant-ngp, NeRF) or COLMAP's model in it, else
    /// found by structure from motion
    pub dir: PathBuf,
    /// Training times, e.g. `10s,60s,5m`: trials and steps, without decoding and judging
    #[arg(long, value_name = "TIMES", default_value = "60s", value_delimiter = ',')]
    pub budget: Vec<String>,
    /// The whole wait instead, e.g. `5m`: decoding, training, judging and pictures; no folds
    #[arg(long, value_name = "TIME", conflicts_with = "budget")]
    pub within: Option<String>,
    /// Stop at this PSNR on training photos that are held back, dB
    #[arg(long, value_name = "DB")]
    pub target: Option<f64>,
    /// Folder for `<time>s/<name>.png` and metrics.json
    #[arg(long, value_name = "DIR", default_value = "fit")]
    pub out: PathBuf,
    /// Seed of the training
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Memory the training may take, e.g. `2GB` [default: 4GB]
    #[arg(long, value_name = "SIZE")]
    pub memory: Option<String>,
    /// What decides how large the field is
    #[arg(long, value_enum, default_value_t = Fit::Scene)]
    pub fit: Fit,
}

/// What decides how large a field is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Fit {
    /// The scene and the time
    Scene,
    /// Nothing: the full base configuration of instant-ngp
    Fixed,
}

impl Fit {
    /// Returns the word as pipeline.toml has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scene => "scene",
            Self::Fixed => "fixed",
        }
    }
}

/// Pipelines that `init` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Mission {
    /// A built-in Mars, offline
    Demo,
    /// The built-in Mars at three places, each a scene
    #[value(name = "mission")]
    Places,
    /// Photos in a folder
    Folder,
    /// Mars 2020 Mastcam-Z and Navcam
    Perseverance,
    /// MSL Mastcam and Navcam
    Curiosity,
    /// The helicopter's colour camera
    Ingenuity,
}

/// Methods of `calibrate`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Structure from motion
    Sfm,
    /// Camera models of the labels
    Labels,
    /// transforms.json or a COLMAP model found in the folder
    Import,
    /// An installed COLMAP
    Colmap,
    /// `import` where a file with cameras lies in the folder, else `sfm`
    Auto,
}

impl Method {
    /// Returns the method as pipeline.toml names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sfm => "sfm",
            Self::Labels => "labels",
            Self::Import => "import",
            Self::Colmap => "colmap",
            Self::Auto => "auto",
        }
    }
}
