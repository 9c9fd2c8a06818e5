//! `marf audit --crate`: who made a file, told by a crate alone.

use std::path::Path;

use marf_cache::Digest;
use marf_provenance::stamp::Stamp;

use crate::cli::args::Global;
use crate::cli::copies::object_of;
use crate::cli::error::{Answer, CliError, Diagnostic};
use crate::cli::output::print_json;
use crate::cli::share::{open_crate, verify_crate};
use crate::terminal::{escape_control, print_line};

/// Prints what the run of a crate says of a file.
///
/// # Errors
/// A file or a crate that cannot be read; the answers "altered", of the file or of the crate, and "not ours".
pub fn in_crate(global: &Global, file: &Path, folder: &Path) -> Result<(), CliError> {
    let bytes = std::fs::read(file)
        .map_err(|error| CliError::failed(format!("cannot read {}: {error}", file.display())))?;
    let said = |answer, message: String| Err(CliError::Answered(answer, Diagnostic::new(message)));
    verify_crate(folder)?;
    let named = Stamp::off(&bytes).map(|(_, stamp)| stamp.object);
    let digest = Digest::of(&object_of(bytes));
    if named.is_some_and(|object| object != digest) {
        return said(
            Answer::Altered,
            format!("{} is not what its mark says: it was altered", file.display()),
        );
    }
    match open_crate(folder)?.trace(&digest) {
        Err(cause) => said(Answer::Incomplete, format!("{}: {cause}", folder.display())),
        Ok(None) => said(
            Answer::NotOurs,
            format!(
                "{} was not made by the run of {}",
                file.display(),
                folder.display()
            ),
        ),
        Ok(Some(trace)) if global.json => print_json(&trace),
        Ok(Some(trace)) => {
            print_line(escape_control(&trace.to_string()).trim_end());
            Ok(())
        }
    }
}
