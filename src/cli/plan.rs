use clap::Args;
use marf_engine::{Extent, PlanState, PlannedNode};
use marf_progress::format::{count, duration};
use marf_run::plan::WhyRequest;
use marf_run::{Context, Error};

use super::options::{PipelineArgs, SelectionArgs};
use super::output::print_json;
use crate::terminal::print_line;

/// Arguments of `plan`.
#[derive(Debug, Clone, Args)]
pub struct PlanArgs {
    #[command(flatten)]
    selection: SelectionArgs,
    /// Print one JSON document to stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pipeline: PipelineArgs,
}

/// Arguments of `why`.
#[derive(Debug, Clone, Args)]
pub struct WhyArgs {
    /// Node to explain
    node: String,
    /// List every photo that was added, edited or removed
    #[arg(long)]
    files: bool,
    /// Print one JSON document to stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pipeline: PipelineArgs,
}

/// `marf plan`: the state of every node and the first thing that changed.
pub fn plan(args: PlanArgs, context: Context) -> Result<(), Error> {
    let nodes = marf_run::plan::plan(&args.pipeline.context(context), &args.selection.into())?;
    if args.json {
        return print_json(&nodes);
    }
    for node in &nodes {
        print_line(&line(node));
    }
    print_line(&summary(&nodes));
    Ok(())
}

/// Returns how many nodes will run, and how many may.
fn summary(nodes: &[PlannedNode]) -> String {
    let count = |state: PlanState| nodes.iter().filter(|node| node.state == state).count();
    let (will, may) = (count(PlanState::WillRun), count(PlanState::MayRun));
    let will = format!("{will} of {} nodes will run", nodes.len());
    match may {
        0 => will,
        may => format!("{will}, {may} more if their inputs change"),
    }
}

/// Returns the line of a node: state, reason, photos to look at, time of the last run.
fn line(node: &PlannedNode) -> String {
    let mut line = format!("{:<16} {:<9} {}", node.node, node.state.word(), node.reason);
    if node.state.is_open() {
        let looks = node.extent.map(|extent| looks_at(&extent));
        let took = node
            .needs
            .seconds
            .map(|seconds| format!("{} last time", duration(seconds)));
        for part in looks.into_iter().chain(took) {
            line.push_str(&format!(", {part}"));
        }
    }
    line.trim_end().to_owned()
}

/// Returns `30 photos of 1 sol`, or `1 sol` where the photos are not fetched yet.
fn looks_at(extent: &Extent) -> String {
    let sols = count(extent.shards as usize, "sol");
    match extent.photos {
        Some(photos) => format!("{} of {sols}", count(photos as usize, "photo")),
        None => sols,
    }
}

/// `marf why NODE`: every difference from the action of its last result, with `--files` also every photo.
pub fn why(args: WhyArgs, context: Context) -> Result<(), Error> {
    let request = WhyRequest {
        node: args.node,
        with_photos: args.files,
    };
    let planned = marf_run::plan::why(&args.pipeline.context(context), &request)?;
    if args.json {
        return print_json(&planned);
    }
    print_line(&format!(
        "{} ({}): {}",
        planned.node,
        planned.state.word(),
        planned.reason
    ));
    print_changes(&planned);
    Ok(())
}

fn print_changes(planned: &PlannedNode) {
    if let Some(key) = planned.key {
        print_line(&format!("  key {key}"));
    }
    for change in &planned.changes {
        print_line(&format!("  {change}"));
    }
}
