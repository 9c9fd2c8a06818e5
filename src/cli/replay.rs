//! `marf replay`: a run made again in an empty store, from its root and the pinned bytes alone.

use std::path::PathBuf;

use clap::Args;
use marf_provenance::difference::value_text;
use marf_provenance::replay::{NotMade, Replayed};
use marf_run::replay::{ReplayReport, differs, is_equal, is_missing};
use marf_run::{Context, Error};

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
The replay contacts no server. It uses only the root of the run, the files that the run read from archives, and the results of stages \
that are declared to vary (COLMAP's cameras). A training with a time limit is repeated by its recorded schedule.
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
    let mut lines = Vec::new();
    for node in &report.nodes {
        let word = match (&node.not_made, node.differs.len()) {
            (Some(NotMade::TakenOver(why)), _) => format!("taken over: {why}"),
            (Some(NotMade::NotMade(why)), _) => format!("not made: {why}"),
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
        "run {} on {} threads: {outputs} outputs of {} nodes are equal, {} nodes differ, {} are declared to vary, {} were not made",
        report.run,
        report.threads,
        count(Replayed::is_equal),
        count(differs),
        count(|node| matches!(node.not_made, Some(NotMade::TakenOver(_)))),
        count(is_missing),
    ));
    if let Some(first) = report.nodes.iter().find(|node| differs(node)) {
        lines.push(format!("the first that differs is `{}`", first.node));
    }
    lines
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
            ", from byte {} on, {} bytes of {was} ({is} now)",
            found.first_byte, found.differing_bytes
        ));
        for value in found.values.iter().take(MOST_VALUES) {
            text.push_str(&format!(", {}", value_text(value)));
        }
    }
    text
}
