//! `marf replay`: a run made again in an empty store, from its root and the pinned bytes alone.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use marf_provenance::difference::value_text;
use marf_provenance::replay::{NotMade, Replayed};
use marf_run::replay::{ReplayReport, ReplayRequest, differs, is_equal, is_missing};
use marf_run::{Context, Error};

use super::feedback::Terminal;
use super::global::Global;
use super::output::print_json;
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
the results of stages that are declared to vary (COLMAP's cameras). A training by the clock is repeated by the schedule that \
it ran.
Exit codes of the answer: 0 every digest is equal, 3 the file was not made by marf, 5 something that is needed is not in the \
store any more, 7 something came out otherwise, 9 nothing did, but not everything could be made again here (it ran on another \
GPU, or failed), 12 the run has no result to compare with.";

/// `marf replay`: runs a run, a node or what made a file again, and compares digests.
pub fn replay(global: &Global, args: ReplayArgs, context: &Context) -> Result<(), Error> {
    // Progress goes to stderr whatever is printed to stdout.
    let context = Context {
        feedback: Arc::new(Terminal::with_progress()),
        ..context.clone()
    };
    let request = ReplayRequest {
        what: args.what,
        scratch: args.scratch,
    };
    let report = marf_run::replay::replay(&context, &request)?;
    if global.json {
        print_json(&report)?;
    } else {
        print_line(&escape_control(&text(&report)));
    }
    is_equal(&report)
}

fn text(report: &ReplayReport) -> String {
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
            text.push_str(&format!("; {}", value_text(value)));
        }
    }
    text
}
