//! `marf exec`: an action, its inputs from a shared store and its result into it.

use std::path::PathBuf;

use clap::Args;
use marf_run::exec::ExecResult;
use marf_run::{Context, Error};

use super::options::{SignArg, ThreadsArg};
use super::traffic::traffic_text;
use crate::terminal::print_line;

/// Arguments of `exec`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ExecArgs {
    /// File with an action, or the key of a result in the shared store, whose action is computed again
    #[arg(value_name = "ACTION")]
    pub action: String,
    /// Address of the shared store: file:///FOLDER or s3://BUCKET/PREFIX
    #[arg(long, value_name = "URL")]
    pub store: Option<PathBuf>,
    /// File for the outcome, written atomically
    #[arg(long, value_name = "FILE")]
    pub result: Option<PathBuf>,
    /// Folder for checkpoints and fetched inputs, kept until there is a result [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
    #[command(flatten)]
    sign: SignArg,
    #[command(flatten)]
    threads: ThreadsArg,
}

const AFTER_HELP: &str = "\
`marf run --on slurm` writes actions and submits jobs that call this verb. ACTION may also be the question of a run which backend its \
jobs have. Only inputs that are read are fetched. An existing result stays and is compared with the new one.
Exit codes: 0 the result is in the shared store, 1 it could not be computed, 10 another version of marf or another machine must compute \
it, or it is a part of a node, 130 stopped at a checkpoint.";

/// `marf exec`: computes an action, and prints its outcome.
pub fn exec(args: ExecArgs, context: Context) -> Result<(), Error> {
    let context = Context {
        store: args.store,
        ..args.sign.context(args.threads.context(context))
    };
    let (result, scratch) = (args.result.as_deref(), args.scratch.as_deref());
    match marf_run::exec::exec(&context, &args.action, result, scratch)? {
        ExecResult::Action(action, traffic) => {
            print_line(&format!("{} {}", action.stage, action.key()));
            print_line(&traffic_text(traffic));
        }
        ExecResult::Backend(backend) => backend.iter().for_each(|backend| print_line(backend)),
    }
    Ok(())
}
