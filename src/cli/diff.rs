//! `marf diff`: what changed between two runs, node by node.

use clap::Args;
use marf_run::{Context, Error};

use super::options::RecordArgs;
use super::output::print_json;
use crate::terminal::{print_line, print_lines};

/// Arguments of `diff`.
#[derive(Debug, Clone, Args)]
pub struct DiffArgs {
    /// Number of the first run
    pub first: u64,
    /// Number of the second run
    pub second: u64,
    #[command(flatten)]
    record: RecordArgs,
}

/// `marf diff`: prints parameters, products, metrics and pictures that differ between two runs.
pub fn diff(args: DiffArgs, context: Context) -> Result<(), Error> {
    let diff = marf_run::diff::diff(&args.record.store.context(context), args.first, args.second)?;
    if args.record.json {
        return print_json(&diff);
    }
    let [first, second] = [args.first, args.second].map(|number| format!("run {number}"));
    for node in &diff.nodes {
        print_line(&node.heading(&first, &second));
        print_lines(node.lines().iter().map(|line| format!("  {line}")));
    }
    print_line(&format!(
        "{} of {} nodes differ between {first} and {second} (--json lists everything)",
        diff.nodes.len(),
        diff.of_nodes
    ));
    Ok(())
}
