//! The verbs of the command line. The arguments of a verb are in the verb's file.

use std::path::PathBuf;

use clap::{Parser, Subcommand};

use super::global::Global;

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

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Run what changed, and write the report
    Run(super::run::RunArgs),
    /// Show which nodes would run, and the first thing that changed
    Plan(super::selection::SelectionArgs),
    /// Show why a node would run, or the key of its result
    Why(super::plan::WhyArgs),
    /// Compute one action, its inputs from a shared store and its result into it: what a job of a batch system runs
    Exec(super::exec::ExecArgs),
    /// Show the nodes of the last run
    Status,
    /// List the runs so far
    Log(super::log::LogArgs),
    /// Write a commented pipeline.toml
    Init(super::init::InitArgs),
    /// Print the JSON schema of pipeline.toml, for editors, or of the lines of `run --json`
    Schema(super::schema::SchemaArgs),
    /// Write report.html of the last run
    Report(super::report::ReportArgs),
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
        verb: super::export::ExportVerb,
    },
    /// Check a crate or a signed statement, without a store
    Verify(super::verify::VerifyArgs),
    /// Tell who made a file, from which bytes, or what a product went into
    Audit(super::audit::AuditArgs),
    /// Make a run again in an empty store, from the bytes that it read, and compare all digests
    Replay(super::replay::ReplayArgs),
    /// Tell what changed between two runs: parameters, products, metrics, pictures
    Diff(super::diff::DiffArgs),
    /// Inspect the store
    Cache {
        /// What to do with it
        #[command(subcommand)]
        verb: super::cache::CacheVerb,
    },
    /// Filter the photos of a folder, and show every verdict
    Filter(super::filter::FilterArgs),
    /// Show what was read of every photo: format, size, the label's camera, site, drive and pose, sol
    Photos(super::photos::PhotosArgs),
    /// Find the cameras of a folder's photos
    Calibrate(super::calibrate::CalibrateArgs),
    /// Train a field on the photos of a folder, with the cameras beside them or by structure from motion, and render the held-out views
    Fit(super::fit::FitArgs),
    /// Measure what each knob costs in time and gains in quality
    Trade(super::trade::TradeArgs),
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
