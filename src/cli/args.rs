//! The command line, as clap reads it.

use std::num::NonZero;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use marf_field::Device;
use marf_stage::Access;

use crate::config::GlobalOptions;

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
    /// Train a field on images/ and transforms.json of a folder, and render the held-out views
    Fit(FitArgs),
    /// Benchmark this program
    Bench {
        /// What to measure
        #[command(subcommand)]
        verb: BenchVerb,
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
    /// transforms.json to write; metrics.json, sparse/0 (COLMAP's model) and the points.ply it names go beside it
    #[arg(long, value_name = "FILE", default_value = "transforms.json")]
    pub out: PathBuf,
    /// Where cameras come from
    #[arg(long, value_enum, default_value_t = Method::Sfm)]
    pub method: Method,
}

/// Arguments of `fit`.
#[derive(Debug, Clone, Args)]
pub struct FitArgs {
    /// A folder with images/, transforms.json (nerfstudio convention) and the points it names
    pub dir: PathBuf,
    /// Training times, e.g. `10s,60s,5m`
    #[arg(long, value_name = "TIMES", default_value = "60s", value_delimiter = ',')]
    pub budget: Vec<String>,
    /// Folder for `<budget>s/<name>.png` and metrics.json
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

/// Verbs of `bench`.
#[derive(Debug, Clone, Subcommand)]
pub enum BenchVerb {
    /// Train on a folder's photos for so many seconds and score the test views: one JSON line a budget
    Train(BenchArgs),
    /// Make a synthetic archive and run folder, filters and store on it: cold, without a change, with new sols; one JSON
    /// line a phase
    Engine(EngineArgs),
    /// Run engine, store and two filters on rows without photos: what a million items cost when nothing changes; one JSON
    /// line a phase
    Items(ItemsArgs),
    /// Kill, stop, damage and starve runs of a small pipeline, and compare every digest; one JSON line a fault
    Faults(FaultsArgs),
}

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
    /// A bit flipped, a cut, an emptying in every file of a store
    Damage,
    /// Writes that fail
    Full,
    /// Eight programs on one store
    Eight,
    /// Garbage collections beside eight programs
    Collect,
    /// File times far off
    Clock,
}

impl Fault {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Kill,
        Self::Interrupt,
        Self::Damage,
        Self::Full,
        Self::Eight,
        Self::Collect,
        Self::Clock,
    ];

    /// Returns the word of the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kill => "kill",
            Self::Interrupt => "interrupt",
            Self::Damage => "damage",
            Self::Full => "full",
            Self::Eight => "eight",
            Self::Collect => "collect",
            Self::Clock => "clock",
        }
    }
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
pub struct BenchArgs {
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
}

/// Clocks of `bench`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Clock {
    /// Wall clock, as the comparison asks
    Wall,
    /// Processor time over the number of threads, for a machine that does other work too
    Cpu,
}

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

/// Pipelines that `init` writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Mission {
    /// A built-in Mars, offline
    Demo,
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
}

impl Method {
    /// Returns the method as pipeline.toml names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sfm => "sfm",
            Self::Labels => "labels",
            Self::Import => "import",
            Self::Colmap => "colmap",
        }
    }
}
