use super::error::CliError;
use crate::terminal::print_line;

/// Prints a value as indented JSON to stdout.
///
/// # Errors
/// A value that JSON cannot express.
pub fn print_json(value: &impl serde::Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value).map_err(|error| CliError::failed(error.to_string()))?;
    print_line(&text);
    Ok(())
}
