//! Handles Ctrl-C and runs the command line.

use std::process::ExitCode;

use marf_engine::Cancel;

fn main() -> ExitCode {
    let cancel = Cancel::default();
    let asked = cancel.clone();
    // The first Ctrl-C asks to stop at the next check; the second stops now, which the store survives.
    let handler = ctrlc::set_handler(move || {
        if asked.is_set() {
            #[allow(clippy::exit, reason = "the user has asked twice")]
            std::process::exit(130);
        }
        asked.set();
    });
    if let Err(error) = handler {
        marf::terminal::eprint_line(&format!(
            "warning: Ctrl-C stops at once and not at a checkpoint: {error}"
        ));
    }
    marf::cli::main(&cancel)
}
