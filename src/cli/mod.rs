//! The verbs, one file each.

mod again;
mod args;
mod audit;
mod bench;
mod budget;
mod cache;
mod calibrate;
mod compare;
mod copies;
mod diff;
mod documents;
mod error;
mod exec;
mod export;
mod export_table;
mod field_file;
mod file_state;
mod files;
mod filter;
mod fit;
mod folder;
mod init;
mod log;
mod man;
mod manual_lists;
mod on;
mod output;
mod photos;
mod plan;
mod program;
mod progress;
mod render;
mod replay;
mod report;
mod run;
mod scenes;
mod session;
mod share;
mod shared;
mod status;
mod trade;
mod trust;
mod verdicts;
mod view;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};
use marf_engine::Cancel;

use crate::terminal::{eprint_line, print_line};
use args::{Cli, SchemaOf, Verb};
use error::CliError;
use output::print_json;

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
    match dispatch(&cli, cancel) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A wait for another program ends with Ctrl-C, and nothing else went wrong.
            let is_stopped = cancel.is_set() && matches!(error, CliError::Locked(_));
            let error = if is_stopped { CliError::Interrupted } else { error };
            eprint_line(&error.render());
            error.code()
        }
    }
}

fn dispatch(cli: &Cli, cancel: &Cancel) -> Result<(), CliError> {
    let global = &cli.global;
    std::env::set_current_dir(&global.directory)
        .map_err(|error| CliError::usage(format!("-C {}: {error}", global.directory.display())))?;
    match &cli.verb {
        Verb::Run(args) => run::run(global, args, cancel),
        Verb::Plan(args) => plan::plan(global, args, cancel),
        Verb::Why { node, files } => plan::why(global, node, *files, cancel),
        Verb::Status => status::status(global, cancel),
        Verb::Log { last } => log::log(global, *last, cancel),
        Verb::Init { mission } => init::init(global, *mission),
        Verb::Schema { of } => match of {
            SchemaOf::Pipeline => print_json(&marf_config::schema()),
            SchemaOf::Events => print_json(&marf_progress::event_schema()),
        },
        Verb::Report { out } => report::report(global, out, cancel),
        Verb::View(args) => view::view(global, args, cancel),
        Verb::Render(args) => render::render(global, args, cancel),
        Verb::Compare(args) => compare::compare(global, args, cancel),
        Verb::Export { verb } => share::export(global, verb, cancel),
        Verb::Verify(args) => share::verify_path(global, args),
        Verb::Audit(args) => audit::audit(global, args, cancel),
        Verb::Diff(args) => diff::diff(global, args, cancel),
        Verb::Replay(args) => replay::replay(global, args, cancel),
        Verb::Exec(args) => exec::exec(global, args, cancel),
        Verb::Cache { verb } => cache::cache(global, verb, cancel),
        Verb::Filter(args) => filter::filter(global, args, cancel),
        Verb::Photos { dir, node } => photos::photos(global, dir.as_deref(), node, cancel),
        Verb::Calibrate(args) => calibrate::calibrate(global, args, cancel),
        Verb::Fit(args) => fit::fit(global, args, cancel),
        Verb::Trade(args) => trade::trade(global, args, cancel),
        Verb::Bench { verb } => bench::bench(global, verb, cancel),
        Verb::Man { dir } => man::man(dir),
        Verb::Completions { shell } => {
            let mut bytes = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "marf", &mut bytes);
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
