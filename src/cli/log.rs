use clap::Args;
use marf_engine::{NodeState, RunRecord, RunSource};
use marf_export::iso_time;
use marf_progress::format::duration;
use marf_run::{Context, Error};

use super::options::RecordArgs;
use super::output::print_json;
use crate::terminal::print_line;

/// Arguments of `log`.
#[derive(Debug, Clone, Args)]
pub struct LogArgs {
    /// Number of runs to list
    #[arg(short = 'n', long, default_value_t = 20)]
    last: usize,
    #[command(flatten)]
    record: RecordArgs,
}

/// `marf log`: the runs so far, the newest first.
pub fn log(args: LogArgs, context: Context) -> Result<(), Error> {
    let context = args.record.store.context(context);
    let runs = marf_engine::runs(&context.existing_store()?, context.warnings())?;
    let shown: Vec<_> = runs.iter().rev().take(args.last).collect();
    if args.record.json {
        return print_json(&shown);
    }
    for run in shown {
        let nodes = || run.nodes.iter().filter(|node| node.parent.is_none());
        let count = |state: NodeState| nodes().filter(|node| node.state == state).count();
        let derived = derived(&runs, run).map(|what| format!("  ({what})"));
        print_line(&format!(
            "{:>4}  {}  {:<9} {:>3} ran, {:>3} reused, {} failed  {:>12}  {}{}",
            run.number,
            iso_time(run.started_unix_s),
            format!("{:?}", run.outcome).to_lowercase(),
            count(NodeState::Finished),
            count(NodeState::Reused),
            count(NodeState::Failed),
            duration(run.seconds),
            run.command,
            derived.unwrap_or_default(),
        ));
    }
    Ok(())
}

/// Returns the purpose and the base of a derived run. None for a run of a pipeline or folder.
fn derived(runs: &[RunRecord], run: &RunRecord) -> Option<String> {
    let RunSource::Derived { from, purpose } = run.source else {
        return None;
    };
    let base = runs.iter().find(|base| from.is_some() && base.root == from);
    Some(base.map_or_else(
        || purpose.to_string(),
        |base| format!("{purpose} of run {}", base.number),
    ))
}
