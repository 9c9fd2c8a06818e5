//! `marf replay`: a run made again in an empty store, from its root and the pinned bytes alone.

mod plan;
mod target;

use std::path::PathBuf;

use clap::Args;
use marf_cache::Store;
use marf_engine::{Cancel, Options, Outcome};
use marf_provenance::lineage::Lineage;
use marf_provenance::replay::{Replayed, compare};
use serde::Serialize;

use self::plan::{Plan, plan};
use self::target::{Target, target};
use super::args::Global;
use super::error::{Answer, CliError, Diagnostic};
use super::output::print_json;
use super::program;
use super::session::{existing_store, warn};
use crate::progress::Progress;
use crate::terminal::{escape_control, print_line};

/// Arguments of `replay`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ReplayArgs {
    /// Number of a run, a node of the last run, or a file that a run made [default: the last run]
    #[arg(value_name = "RUN|NODE|FILE")]
    pub what: Option<String>,
    /// Folder for the store of the replay, which is kept [default: a temporary one]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
}

const AFTER_HELP: &str = "\
Nothing is asked of any server, and nothing of the first run is used but its root, the files that it read from archives, and \
the results of stages that are declared to vary (the steps that a time budget bought, COLMAP's cameras).
Exit codes of the answer: 0 every digest is equal, 3 the file was not made by marf, 5 something that is needed is not in the \
store any more, 7 something came out otherwise.";

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report<'a> {
    run: u64,
    threads: usize,
    nodes: &'a [Replayed],
}

/// `marf replay`: runs a run, a node or what made a file again, and compares digests.
pub fn replay(global: &Global, args: &ReplayArgs, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
    let Target { run, node } = target(&store, args.what.as_deref())?;
    let lineage = Lineage::of(&store, run)?;
    let nodes = match &node {
        Some(node) => lineage.upstream(node),
        None => lineage.nodes.iter().collect(),
    };
    let temporary = match args.scratch {
        Some(_) => None,
        None => Some(tempfile::tempdir().map_err(|error| CliError::failed(error.to_string()))?),
    };
    let dir = match (&args.scratch, &temporary) {
        (Some(dir), _) => dir.clone(),
        (None, Some(temporary)) => temporary.path().join("store"),
        (None, None) => PathBuf::new(),
    };
    let scratch = empty_store(&dir, cancel)?;
    let Plan { graph, to, declared } = plan(&lineage, &nodes, &scratch).map_err(incomplete)?;
    let options = Options {
        threads: global.threads,
        to,
        pipeline: lineage.run.pipeline.clone(),
        command: format!("replay of run {}", lineage.run.number),
        program: program::PROGRAM.to_owned(),
        ..Options::default()
    };
    let record = marf_engine::run(&graph, &scratch, &options, &Progress::for_stderr(), cancel)?;
    if record.outcome == Outcome::Cancelled {
        return Err(CliError::Interrupted);
    }
    let replayed = compare(&lineage, &nodes, (&record, &scratch), &declared)?;
    let report = Report {
        run: lineage.run.number,
        threads: record.threads,
        nodes: &replayed,
    };
    match global.json {
        true => print_json(&report)?,
        false => print_line(&escape_control(&text(&report))),
    }
    scratch.take_warnings().into_iter().for_each(warn);
    told(&report)
}

/// Opens the store of a replay, which must be empty: what it had would be taken for what the replay made.
fn empty_store(dir: &std::path::Path, cancel: &Cancel) -> Result<Store, CliError> {
    let is_empty = std::fs::read_dir(dir).map_or(true, |mut entries| entries.next().is_none());
    if !is_empty {
        return Err(CliError::usage(format!(
            "--scratch {}: the folder is not empty",
            dir.display()
        )));
    }
    super::session::open_store(dir, cancel)
}

/// Makes an answer of an error that something is lost.
fn incomplete(error: CliError) -> CliError {
    match error {
        CliError::Failed(diagnostic) => CliError::Answered(Answer::Incomplete, diagnostic),
        other => other,
    }
}

fn text(report: &Report<'_>) -> String {
    let mut lines = Vec::new();
    for node in report.nodes {
        let word = match (&node.not_made, node.differs.len()) {
            (Some(why), _) if node.is_declared => format!("taken over: {why}"),
            (Some(why), _) => format!("not made: {why}"),
            (None, 0) => format!("equal, {} outputs", node.equal),
            (None, count) => format!("differs, {count} of {} outputs", node.equal + count as u64),
        };
        lines.push(format!("{:<22} {word}", node.node));
        lines.extend(
            node.differs
                .iter()
                .map(|output| format!("  {}", difference(output))),
        );
    }
    let count = |wanted: fn(&Replayed) -> bool| report.nodes.iter().filter(|node| wanted(node)).count();
    let outputs: u64 = report.nodes.iter().map(|node| node.equal).sum();
    lines.push(format!(
        "run {} on {} threads: {outputs} outputs of {} nodes are equal, {} nodes differ, {} are declared to vary",
        report.run,
        report.threads,
        count(|node| node.not_made.is_none() && node.differs.is_empty()),
        count(|node| !node.is_equal()),
        count(|node| node.is_declared),
    ));
    if let Some(first) = report.nodes.iter().find(|node| !node.is_equal()) {
        lines.push(format!("the first that differs is `{}`", first.node));
    }
    lines.join("\n")
}

/// Most values of a document that are named.
const MOST_VALUES: usize = 3;

fn difference(output: &marf_provenance::replay::DifferingOutput) -> String {
    let digest =
        |digest: Option<marf_cache::Digest>| digest.map_or("absent".to_owned(), |digest| digest.short());
    let mut text = format!(
        "{}: {} -> {}",
        output.output,
        digest(output.was),
        digest(output.is)
    );
    if let Some(found) = &output.difference {
        let (was, is) = found.bytes;
        text.push_str(&format!(
            "; from byte {} on, {} bytes of {was} ({is} now)",
            found.first_byte, found.differing_bytes
        ));
        for value in found.values.iter().take(MOST_VALUES) {
            text.push_str(&format!("; {value}"));
        }
    }
    text
}

fn told(report: &Report<'_>) -> Result<(), CliError> {
    match report.nodes.iter().find(|node| !node.is_equal()) {
        None => Ok(()),
        Some(first) => Err(CliError::Answered(
            Answer::Differs,
            Diagnostic::new(format!(
                "run {} did not come out as it was, first at `{}`",
                report.run, first.node
            )),
        )),
    }
}
