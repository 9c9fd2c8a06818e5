//! The verbs, one file each.

mod archive;
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
mod init;
mod key;
mod log;
mod man;
mod options;
mod output;
mod photos;
mod plan;
mod progress;
mod render;
mod replay;
mod report;
mod run;
mod schema;
mod status;
mod trade;
mod traffic;
mod verify;
mod view;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::{CommandFactory, Parser};
use marf_config::GlobalOptions;
use marf_engine::Cancel;
use marf_report::visible;
use marf_run::{Context, Error, Signing};

use crate::terminal::{eprint_line, print_own};
use args::{Cli, Verb};
use feedback::Terminal;

/// Parses the command line, runs the verb and returns the exit code.
///
/// `cancel` is set by the caller when the user wants to stop.
pub fn main(cancel: &Cancel) -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            let code = ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
            if error.use_stderr() {
                // An error of escaped arguments has no line breaks of theirs.
                let escaped = std::env::args_os().map(|arg| visible(&arg.to_string_lossy()).into_owned());
                let error = Cli::try_parse_from(escaped).err().unwrap_or(error);
                error.render().to_string().lines().for_each(eprint_line);
            } else {
                let _ = error.print(); // help; a closed pipe is no error
            }
            return code;
        }
    };
    match dispatch(cli, cancel) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // A wait for another program ends with Ctrl-C, and nothing else went wrong.
            let is_stopped = cancel.is_set() && matches!(error, Error::Locked(_));
            let error = if is_stopped { Error::Interrupted } else { error };
            error::lines(&error).iter().for_each(|line| eprint_line(line));
            error::exit_code(&error)
        }
    }
}

/// Returns the context of a verb without options. Progress goes to stderr.
fn context(cancel: &Cancel) -> Context {
    let file = PathBuf::from("pipeline.toml");
    Context {
        command: options::command(&file),
        file,
        store: None,
        sets: Vec::new(),
        threads: None,
        config: GlobalOptions::default(),
        commit: option_env!("MARF_COMMIT"),
        feedback: Arc::new(Terminal::with_progress()),
        signing: Signing::default(),
        cancel: cancel.clone(),
    }
}

fn dispatch(cli: Cli, cancel: &Cancel) -> Result<(), Error> {
    let folder = &cli.global.directory;
    std::env::set_current_dir(folder)
        .map_err(|error| Error::usage(format!("-C {}: {error}", folder.display())))?;
    let context = context(cancel);
    match cli.verb {
        Verb::Run(args) => run::run(args, context),
        Verb::Plan(args) => plan::plan(args, context),
        Verb::Why(args) => plan::why(args, context),
        Verb::Archive { verb } => archive::archive(verb, context),
        Verb::Status(args) => status::status(args, context),
        Verb::Log(args) => log::log(args, context),
        Verb::Init(args) => init::init(&args),
        Verb::Schema(args) => schema::schema(&args),
        Verb::Report(args) => report::report(args, context),
        Verb::View(args) => view::view(args, context),
        Verb::Render(args) => render::render(args, context),
        Verb::Compare(args) => compare::compare(args, context),
        Verb::Export { verb } => export::export(verb, context),
        Verb::Verify(args) => verify::verify(&args, &context.cancel),
        Verb::Audit(args) => audit::audit(args, context),
        Verb::Diff(args) => diff::diff(args, context),
        Verb::Replay(args) => replay::replay(args, context),
        Verb::Exec(args) => exec::exec(args, context),
        Verb::Cache { verb } => cache::cache(verb, context),
        Verb::Key { verb } => key::key(verb),
        Verb::Filter(args) => filter::filter(args, context),
        Verb::Photos(args) => photos::photos(args, context),
        Verb::Calibrate(args) => calibrate::calibrate(args, context),
        Verb::Fit(args) => fit::fit(args, context),
        Verb::Trade(args) => trade::trade(args, context),
        Verb::Man { dir } => man::man(&dir),
        Verb::Completions { shell } => {
            let mut bytes = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "marf", &mut bytes);
            print_own(String::from_utf8_lossy(&bytes).trim_end());
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
