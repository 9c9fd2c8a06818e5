use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use marf_engine::{NodeState, Outcome, document};
use marf_progress::format::{count, duration};
use marf_run::results::{result, state_word};
use marf_run::run::PipelineRun;
use marf_run::{Context, Error};

use super::feedback::Terminal;
use super::options::{PipelineArgs, SelectionArgs, SignArg};
use crate::terminal::{eprint_line, print_lines};

/// Arguments of `run`.
#[derive(Debug, Clone, Args)]
pub struct RunArgs {
    #[command(flatten)]
    pub selection: SelectionArgs,
    /// Folder for pictures, models and the report
    #[arg(long, value_name = "DIR", default_value = "out")]
    pub out: PathBuf,
    /// Compute trainings as jobs of a batch system: `slurm`, or another that the site file describes
    #[arg(long = "on", value_enum, value_name = "SYSTEM", hide_possible_values = true)]
    pub batch_system: Option<BatchSystem>,
    /// Site file: shared store, job folder, commands and limits of the batch system. Results do not depend on it
    #[arg(long, value_name = "FILE", default_value = "site.toml")]
    pub site: PathBuf,
    /// Print events to stdout, one JSON object a line
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    sign: SignArg,
    #[command(flatten)]
    pipeline: PipelineArgs,
}

/// A batch system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum BatchSystem {
    /// Slurm, or a program with its commands
    Slurm,
}

/// `marf run`: runs what changed, writes pictures, models and the report.
pub fn run(args: RunArgs, context: Context) -> Result<(), Error> {
    let mut context = args.sign.context(args.pipeline.context(context));
    if args.json {
        context.feedback = Arc::new(Terminal::with_json_lines());
    }
    let site = args.batch_system.map(|_| args.site.as_path());
    let run = marf_run::run::run(&context, &args.selection.into(), &args.out, site)?;
    if !args.json {
        print_lines(table(&run));
        print_lines(summary(&run)?);
        if run.execution.record.outcome != Outcome::Cancelled {
            eprint_line(&format!("report: {}", args.out.join(document::REPORT).display()));
        }
    }
    run.execution.done().map(|_| ())
}

/// Returns the figures of the result, one a line.
fn summary(run: &PipelineRun) -> Result<Vec<String>, Error> {
    let figures = run.summary()?;
    let lines = figures.iter().map(|(name, text)| format!("{name:<20} {text}"));
    Ok(lines.collect())
}

/// Returns the nodes of a run as a table: state, time, result.
fn table(run: &PipelineRun) -> Vec<String> {
    let record = &run.execution.record;
    let shown = || record.nodes.iter().filter(|node| node.parent.is_none());
    let width = shown().map(|node| node.name.len()).fold(16, usize::max);
    let mut lines = vec![format!(
        "{:<width$} {:<9} {:>12}  result",
        "node", "state", "time"
    )];
    for node in shown() {
        let time = if node.state == NodeState::Finished {
            duration(node.seconds)
        } else {
            String::new()
        };
        let state = state_word(node.state);
        lines.push(
            format!(
                "{:<width$} {state:<9} {time:>12}  {}",
                node.name,
                result(node, &run.session)
            )
            .trim_end()
            .to_owned(),
        );
    }
    let ran = shown().filter(|node| node.state == NodeState::Finished).count();
    lines.push(format!(
        "{ran} of {} ran in {}",
        count(shown().count(), "node"),
        duration(record.seconds)
    ));
    lines
}
