//! `marf replay`: a run made again in an empty store, from its root and the pinned bytes alone.

use std::path::PathBuf;

use clap::Args;
use marf_progress::format::{count, size};
use marf_provenance::difference::value_text;
use marf_provenance::replay::Replayed;
use marf_run::replay::{ReplayReport, differs, is_equal, is_missing};
use marf_run::{Answer, Context, Error};

use super::options::{RecordArgs, ThreadsArg};
use super::output::print_json;
use crate::terminal::print_lines;

/// Arguments of `replay`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ReplayArgs {
    /// Run number, node of the newest run, or file that a run wrote [default: the newest run]
    #[arg(value_name = "RUN|NODE|FILE")]
    pub what: Option<String>,
    /// Folder for the store of the replay, which is kept [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    #[command(flatten)]
    record: RecordArgs,
    #[command(flatten)]
    threads: ThreadsArg,
}

const AFTER_HELP: &str = "\
The replay contacts no server. It uses only the root of the run and the files that the run read from archives. A training with a time \
limit is repeated by its recorded schedule.
Exit codes: 0 all digests are equal, 3 the file was not written by marf, 5 the store no longer has something that is needed, 7 a digest \
differs, 9 no digest differs, but something could not be repeated here (it ran on another GPU, or failed), 12 the run has no result to \
compare with.";

/// `marf replay`: runs a run, a node or what made a file again, and compares digests.
pub fn replay(args: ReplayArgs, context: Context) -> Result<(), Error> {
    let context = args.threads.context(args.record.store.context(context));
    let report = marf_run::replay::replay(&context, args.what.as_deref(), args.scratch.as_deref())?;
    if args.record.json {
        print_json(&report)?;
    } else {
        print_lines(text(&report));
    }
    is_equal(&report)
}

fn text(report: &ReplayReport) -> Vec<String> {
    let mut lines = vec![sentence(report), String::new()];
    for node in &report.nodes {
        let outputs = count(node.equal as usize + node.differs.len(), "result");
        let word = match (&node.not_made, node.differs.len()) {
            (Some(why), _) => format!("not repeated: {why}"),
            (None, 0) => format!("equal, {outputs}"),
            (None, different) => format!("different, {different} of {outputs}"),
        };
        lines.push(format!("{:<22} {word}", node.node));
        lines.extend(
            node.differs
                .iter()
                .map(|output| format!("  {}", difference(output))),
        );
    }
    lines.push(format!(
        "run {} on {}",
        report.run,
        count(report.threads, "thread")
    ));
    lines
}

/// Returns the answer in a sentence that takes no knowledge of marf.
fn sentence(report: &ReplayReport) -> String {
    let nodes = |wanted: fn(&Replayed) -> bool| report.nodes.iter().filter(move |node| wanted(node));
    let what = match &report.node {
        Some(node) => format!("`{node}` of run {} and all that leads to it", report.run),
        None => format!("Run {}", report.run),
    };
    let equal: usize = report.nodes.iter().map(|node| node.equal as usize).sum();
    let different: usize = nodes(differs).map(|node| node.differs.len()).sum();
    let all = format!(
        "{} of {}",
        count(equal + different, "result"),
        count(nodes(|node| !is_missing(node)).count(), "node")
    );
    match (report.answer, nodes(differs).next(), nodes(is_missing).next()) {
        (Answer::Differs, Some(first), _) => format!(
            "{what} did not give the same bytes when repeated: {different} of {all} differ, first in `{}`.",
            first.node
        ),
        (Answer::NotMade, _, Some(first)) => format!(
            "{what} could not be repeated in full here: {} of {}, first `{}`. What was repeated gave the same bytes: {all}.",
            nodes(is_missing).count(),
            count(report.nodes.len(), "node"),
            first.node
        ),
        (Answer::NoResult, ..) => format!(
            "Nothing was compared: run {} has no result that can be repeated.",
            report.run
        ),
        _ => format!("{what} gave the same bytes when repeated: all {all} are equal."),
    }
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
            ", from byte {} on, {} of {} ({} now)",
            found.first_byte,
            count(found.differing_bytes as usize, "byte"),
            size(was),
            size(is)
        ));
        for value in found.values.iter().take(MOST_VALUES) {
            text.push_str(&format!(", {}", value_text(value)));
        }
    }
    text
}
