//! `marf exec`: actions, their inputs from a shared store and their results into it.

use std::path::PathBuf;

use clap::Args;
use marf_run::exec::{ExecRequest, ExecResult};
use marf_run::{Context, Error};

use super::traffic::traffic_text;
use crate::terminal::print_line;

/// Arguments of `exec`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct ExecArgs {
    /// A file with actions, a line each, or the key of a result in the shared store, whose action is then computed again
    #[arg(value_name = "ACTION")]
    pub action: String,
    /// Address of the shared store: file:///FOLDER or s3://BUCKET/PREFIX
    #[arg(long, value_name = "URL")]
    pub store: Option<PathBuf>,
    /// Write here how it ended, whole or not at all
    #[arg(long, value_name = "FILE")]
    pub result: Option<PathBuf>,
    /// Folder for checkpoints and what was fetched, kept until there is a result [default: a temporary one]
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,
}

const AFTER_HELP: &str = "\
ACTION may also be the question of a run which backend its jobs have.
Of the inputs only those are fetched that are \
read; a result that is there already stays, and is compared with this one. `marf run --on slurm` writes actions and submits jobs that call this verb.
Exit codes: 0 the result is in the shared store, 1 it could not be made, 10 another marf or another machine must make it (this one \
would make another key of it, or has another backend), 130 stopped at a checkpoint.";

/// `marf exec`: computes an action, and tells how that ended.
pub fn exec(args: ExecArgs, context: &Context) -> Result<(), Error> {
    let context = Context {
        store: args.store,
        ..context.clone()
    };
    let request = ExecRequest {
        action: args.action,
        result: args.result,
        scratch: args.scratch,
    };
    match marf_run::exec::exec(&context, &request)? {
        ExecResult::Actions(actions, traffic) => {
            for action in actions {
                print_line(&format!("{} {}", action.stage, action.key()));
            }
            print_line(&traffic_text(traffic));
        }
        ExecResult::Backend(backend) => backend.iter().for_each(|backend| print_line(backend)),
    }
    Ok(())
}
