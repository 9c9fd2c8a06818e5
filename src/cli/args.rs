//! The verbs of the command line. The arguments of a verb are in the verb's file.

use std::path::PathBuf;

use clap::{Command, Parser, Subcommand};

use super::options::GlobalArgs;

/// Raw Mars rover and helicopter photos to radiance fields, with proof of how.
#[derive(Debug, Parser)]
#[command(
    name = "marf",
    version,
    about,
    max_term_width = 100,
    arg_required_else_help = true,
    subcommand_value_name = "VERB",
    help_template = help_template()
)]
pub struct Cli {
    /// The verb.
    #[command(subcommand)]
    pub verb: Verb,
    /// Options of all verbs.
    #[command(flatten)]
    pub global: GlobalArgs,
}

/// The verbs as `marf --help` groups them.
const GROUPS: [(&str, &[&str]); 6] = [
    (
        "Pipeline",
        &["init", "run", "plan", "why", "status", "log", "archive"],
    ),
    ("Own photos", &["photos", "filter", "calibrate", "fit"]),
    (
        "Results",
        &["report", "view", "render", "compare", "export", "trade"],
    ),
    ("Provenance", &["audit", "replay", "diff", "verify"]),
    ("Store and cluster", &["cache", "exec", "key"]),
    ("Setup", &["schema", "completions", "man"]),
];

/// Returns the form of `marf --help`, with the verbs in their groups.
fn help_template() -> String {
    let verbs = Verb::augment_subcommands(Command::new("marf"));
    let mut text = "{about-with-newline}\n{usage-heading} {usage}\n".to_owned();
    for (group, names) in GROUPS {
        text += &format!("\n{group}:\n");
        for name in names {
            let about = verbs.find_subcommand(name).and_then(Command::get_about);
            text += &format!(
                "  {name:<12} {}\n",
                about.map(ToString::to_string).unwrap_or_default()
            );
        }
    }
    text + "\nOptions:\n{options}\n\nRun `marf VERB --help` for the options of a verb."
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Run the nodes that are out of date, and write the report
    Run(super::run::RunArgs),
    /// Show which nodes would run, and the first change that causes it
    Plan(super::plan::PlanArgs),
    /// Explain why a node is out of date, or print its key
    Why(super::plan::WhyArgs),
    /// Compute one action of a batch job, using a shared store
    Exec(super::exec::ExecArgs),
    /// Show the nodes of the newest run
    Status(super::status::StatusArgs),
    /// List the runs, newest first
    Log(super::log::LogArgs),
    /// Check whether archives on servers are still as marf expects
    Archive {
        /// What to do
        #[command(subcommand)]
        verb: super::archive::ArchiveVerb,
    },
    /// Write a commented pipeline.toml
    Init(super::init::InitArgs),
    /// Print the JSON schema of pipeline.toml or of `run --json`
    Schema(super::schema::SchemaArgs),
    /// Write report.html of the newest run
    Report(super::report::ReportArgs),
    /// Serve the live report with a 3-D view on a local port
    View(super::view::ViewArgs),
    /// Render pictures and a film along a path through a trained field
    Render(super::render::RenderArgs),
    /// Map what changed on the ground between two times
    Compare(super::compare::CompareArgs),
    /// Export a run or its results for use without the store
    Export {
        /// In which form
        #[command(subcommand)]
        verb: super::export::ExportVerb,
    },
    /// Check a crate or a signed statement, without a store
    Verify(super::verify::VerifyArgs),
    /// Trace a file's provenance, or list everything derived from a product
    Audit(super::audit::AuditArgs),
    /// Repeat a run in an empty store, and compare all digests
    Replay(super::replay::ReplayArgs),
    /// Show what changed between two runs
    Diff(super::diff::DiffArgs),
    /// Inspect, clean, verify or share the store
    Cache {
        /// What to do with it
        #[command(subcommand)]
        verb: super::cache::CacheVerb,
    },
    /// Make a key that signs results
    Key {
        /// What to do
        #[command(subcommand)]
        verb: super::key::KeyVerb,
    },
    /// Filter the photos of a folder, and write every verdict
    Filter(super::filter::FilterArgs),
    /// List photos with their format, size, camera, position and sol
    Photos(super::photos::PhotosArgs),
    /// Find the cameras of the photos of a folder
    Calibrate(super::calibrate::CalibrateArgs),
    /// Train a field on the photos of a folder, and score it
    Fit(super::fit::FitArgs),
    /// Measure what each parameter costs in time and gains in quality
    Trade(super::trade::TradeArgs),
    /// Write a manual page for each verb
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_verb_is_in_one_group_of_the_help() {
        let verbs = Verb::augment_subcommands(Command::new("marf"));
        let mut names: Vec<&str> = verbs.get_subcommands().map(Command::get_name).collect();
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|group| group.1).copied().collect();
        names.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(grouped, names);
    }
}
