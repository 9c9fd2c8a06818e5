use marf_run::Error;

use crate::terminal::print_document;

/// Prints a value as indented JSON to stdout.
///
/// # Errors
/// A value that JSON cannot express.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(value).map_err(|error| Error::failed(error.to_string()))?;
    print_document(&text);
    Ok(())
}
