//! The verbs, one file each.

mod args;
mod audit;
mod cache;
mod calibrate;
mod compare;
mod diff;
mod error;
mod exec;
mod export;
mod feedback;
mod filter;
mod fit;
mod global;
mod init;
mod log;
mod man;
mod output;
mod photos;
mod plan;
mod progress;
mod render;
mod replay;
mod report;
mod run;
mod schema;
mod selection;
mod status;
mod trade;
mod traffic;
mod verify;
mod view;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};
use marf_engine::Cancel;
use marf_run::Error;

use crate::terminal::{eprint_line, print_line};
use args::{Cli, Verb};

/// Parses the command line, runs the verb and returns the exit code.
///
/// `cancel` is set by the caller when the user wants to stop.
pub fn main(cancel: &Cancel) -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let _ = error.print(); // help to stdout, usage errors to stderr; a closed pipe is no error
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    match dispatch(cli, cancel) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A wait for another program ends with Ctrl-C, and nothing else went wrong.
            let is_stopped = cancel.is_set() && matches!(error, Error::Locked(_));
            let error = if is_stopped { Error::Interrupted } else { error };
            eprint_line(&error::text(&error));
            error::exit_code(&error)
        }
    }
}

fn dispatch(cli: Cli, cancel: &Cancel) -> Result<(), Error> {
    let global = &cli.global;
    std::env::set_current_dir(&global.directory)
        .map_err(|error| Error::usage(format!("-C {}: {error}", global.directory.display())))?;
    let context = &global.context(cancel);
    match cli.verb {
        Verb::Run(args) => run::run(global, args, context),
        Verb::Plan(args) => plan::plan(global, args, context),
        Verb::Why(args) => plan::why(global, args, context),
        Verb::Status => status::status(global, context),
        Verb::Log(args) => log::log(global, &args, context),
        Verb::Init(args) => init::init(global, &args),
        Verb::Schema(args) => schema::schema(&args),
        Verb::Report(args) => report::report(&args, context),
        Verb::View(args) => view::view(args, context),
        Verb::Render(args) => render::render(global, args, context),
        Verb::Compare(args) => compare::compare(global, args, context),
        Verb::Export { verb } => export::export(global, verb, context),
        Verb::Verify(args) => verify::verify(global, args),
        Verb::Audit(args) => audit::audit(global, args, context),
        Verb::Diff(args) => diff::diff(global, &args, context),
        Verb::Replay(args) => replay::replay(global, args, context),
        Verb::Exec(args) => exec::exec(args, context),
        Verb::Cache { verb } => cache::cache(global, verb, context),
        Verb::Filter(args) => filter::filter(global, args, context),
        Verb::Photos(args) => photos::photos(global, args, context),
        Verb::Calibrate(args) => calibrate::calibrate(global, args, context),
        Verb::Fit(args) => fit::fit(global, args, context),
        Verb::Trade(args) => trade::trade(global, args, context),
        Verb::Man { dir } => man::man(&dir),
        Verb::Completions { shell } => {
            let mut bytes = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "marf", &mut bytes);
            print_line(String::from_utf8_lossy(&bytes).trim_end());
            Ok(())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        Cli::command().debug_assert();
    }
}
