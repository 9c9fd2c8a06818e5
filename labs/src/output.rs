//! What all programs print, and how they end: JSON to stdout, everything else to stderr.

use std::io::Write as _;
use std::process::ExitCode;

use marf_engine::Cancel;
use marf_run::{Diagnostic, Error};
use serde::Serialize;

/// Why a program ended early. An error of marf keeps its exit code.
pub type AnyError = Box<dyn std::error::Error + Send + Sync>;

/// The end of a program or of a part of it.
pub type Result<T = ()> = std::result::Result<T, AnyError>;

/// Prints a line to stdout. A reader that has gone away is not an error.
pub fn print_line(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// Prints a line to stderr.
pub fn eprint_line(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Prints a value as a line of JSON to stdout.
///
/// # Errors
/// A value that JSON cannot express.
pub fn print_json(value: &impl Serialize) -> Result {
    print_line(&serde_json::to_string(value)?);
    Ok(())
}

/// Prints an error with its cause and hint, and returns the exit code: 2 after a bad argument, 130 after Ctrl-C, else 1.
pub fn print_error(error: &(dyn std::error::Error + Send + Sync + 'static)) -> ExitCode {
    eprint_line(&format!("error: {error}"));
    let error = error.downcast_ref::<Error>();
    if let Some(Diagnostic { cause, hint, .. }) = error.and_then(Error::diagnostic) {
        for (label, text) in [("cause", cause), ("hint", hint)] {
            if let Some(text) = text {
                eprint_line(&format!("  {label}: {text}"));
            }
        }
    }
    ExitCode::from(match error {
        Some(Error::Usage(_)) => 2,
        Some(Error::Interrupted) => 130,
        _ => 1,
    })
}

/// Returns an error if the user wants to stop.
///
/// # Errors
/// The wish to stop.
pub fn go_on(cancel: &Cancel) -> std::result::Result<(), Error> {
    if cancel.is_set() {
        return Err(Error::Interrupted);
    }
    Ok(())
}

/// Returns a number with `places` digits after the point, or `-` for `None`.
pub fn decimal(value: Option<f64>, places: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.places$}"))
}
