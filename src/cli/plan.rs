use marf_engine::{PlanState, PlannedNode};
use serde::Serialize;

use super::args::{Global, Selection};
use super::error::CliError;
use super::output::print_json;
use super::session::Session;
use crate::terminal::print_line;

/// A node, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Row<'a> {
    node: &'a str,
    reason: &'a str,
    state: PlanState,
}

impl<'a> Row<'a> {
    fn of(planned: &'a PlannedNode) -> Self {
        Self {
            node: &planned.node,
            reason: &planned.reason,
            state: planned.state,
        }
    }
}

/// `marf plan`: the state of every node and the first thing that changed.
pub fn plan(global: &Global, selection: &Selection) -> Result<(), CliError> {
    let session = Session::open(global)?;
    let last = session.last()?;
    let mut nodes = marf_engine::plan(&session.graph, &session.store, last.as_ref())?;
    let chosen = session
        .graph
        .select(selection.to.as_slice(), selection.from.as_slice())?;
    nodes.retain(|node| chosen.contains(&node.node));
    if global.json {
        let rows: Vec<Row<'_>> = nodes.iter().map(Row::of).collect();
        return print_json(&rows);
    }
    for node in &nodes {
        print_line(format!("{:<16} {:<9} {}", node.node, word(node.state), node.reason).trim_end());
    }
    let runs = nodes
        .iter()
        .filter(|node| node.state == PlanState::WillRun)
        .count();
    print_line(&format!("{runs} of {} nodes will run", nodes.len()));
    Ok(())
}

/// `marf why NODE`: everything that differs from what made its last result.
pub fn why(global: &Global, node: &str) -> Result<(), CliError> {
    let session = Session::open(global)?;
    let last = session.last()?;
    let planned = marf_engine::why(&session.graph, &session.store, last.as_ref(), node)?;
    if global.json {
        return print_json(&planned);
    }
    print_line(&format!(
        "{} ({}): {}",
        planned.node,
        word(planned.state),
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

fn word(state: PlanState) -> &'static str {
    match state {
        PlanState::Fresh => "fresh",
        PlanState::Cached => "cached",
        PlanState::WillRun => "will run",
    }
}
