use marf_engine::{Cancel, NodeState};
use marf_export::iso_time;

use super::args::Global;
use super::error::CliError;
use super::output::print_json;
use super::session::{existing_store, warn};
use marf_progress::duration;
use crate::terminal::print_line;

/// `marf log`: the runs so far, the newest first.
pub fn log(global: &Global, last: usize, cancel: &Cancel) -> Result<(), CliError> {
    let runs = marf_engine::runs(&existing_store(global, cancel)?, warn)?;
    let shown: Vec<_> = runs.iter().rev().take(last).collect();
    if global.json {
        return print_json(&shown);
    }
    for run in shown {
        let count = |state: NodeState| run.nodes.iter().filter(|node| node.state == state).count();
        print_line(&format!(
            "{:>4}  {}  {:<9} {:>3} ran, {:>3} reused, {} failed  {:>12}  {}",
            run.number,
            iso_time(run.started_unix_s),
            format!("{:?}", run.outcome).to_lowercase(),
            count(NodeState::Finished),
            count(NodeState::Reused),
            count(NodeState::Failed),
            duration(run.seconds),
            run.command,
        ));
    }
    Ok(())
}
