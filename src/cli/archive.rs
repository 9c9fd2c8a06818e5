//! `marf archive`: archives on servers.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use marf_run::archive::{ArchiveChecks, ArchiveReport, CheckState};
use marf_run::{Context, Error};

use super::output::print_json;
use crate::terminal::{print_line, print_lines};

/// Verbs of `archive`.
#[derive(Debug, Clone, Subcommand)]
pub enum ArchiveVerb {
    /// Ask archives for one page of each kind, one label and one picture, and report what marf cannot read any more
    Check(CheckArgs),
}

/// Arguments of `archive check`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct CheckArgs {
    /// Name of an `[archive.NAME]` table [default: every archive on a server]
    name: Option<String>,
    /// Print one JSON document to stdout
    #[arg(long)]
    json: bool,
    /// Pipeline file
    #[arg(short, long, value_name = "FILE", default_value = "pipeline.toml")]
    file: PathBuf,
    /// Override a value, e.g. `archive.perseverance.sols=12`
    #[arg(long = "set", value_name = "NODE.KEY=VALUE")]
    sets: Vec<String>,
}

const AFTER_HELP: &str = "\
It sends about ten requests to each archive, with the pauses of its `network` table. It stores nothing, and marf.lock stays as it is.

Exit codes: 0 everything is as marf expects, 1 something could not be checked, 6 something differs.";

/// `marf archive`.
pub fn archive(verb: ArchiveVerb, context: Context) -> Result<(), Error> {
    let ArchiveVerb::Check(args) = verb;
    let context = Context {
        file: args.file,
        sets: args.sets,
        ..context
    };
    let report = marf_run::archive::check(&context, args.name.as_deref())?;
    if args.json {
        print_json(&report)?;
    } else {
        print_lines(lines(&report));
        if report.answer == CheckState::AsExpected {
            print_line("everything is as marf expects");
        }
    }
    report.is_as_expected()
}

/// Returns a line for each check.
fn lines(report: &ArchiveReport) -> Vec<String> {
    let width = |archive: &ArchiveChecks| archive.checks.iter().map(|check| check.what.len()).max();
    let what = report.archives.iter().filter_map(width).max().unwrap_or(0);
    let name = report
        .archives
        .iter()
        .map(|archive| archive.name.len())
        .max()
        .unwrap_or(0);
    let of_archive = |archive: &ArchiveChecks| -> Vec<String> {
        let line = |check: &marf_run::archive::Check| {
            let address = check.url.iter().filter(|_| check.state == CheckState::Differs);
            let address: String = address.map(|url| format!(" ({url})")).collect();
            format!(
                "{:<name$}  {:<11}  {:<what$}  {}{address}",
                archive.name,
                word(check.state),
                check.what,
                check.found
            )
        };
        archive.checks.iter().map(line).collect()
    };
    report.archives.iter().flat_map(of_archive).collect()
}

fn word(state: CheckState) -> &'static str {
    match state {
        CheckState::AsExpected => "as expected",
        CheckState::Differs => "differs",
        CheckState::NotChecked => "not checked",
    }
}
