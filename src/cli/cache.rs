use super::args::Global;
use super::error::CliError;
use super::output::print_json;
use super::session::existing_store;
use crate::terminal::print_line;

/// `marf cache stat`: objects, bytes, records, runs.
pub fn stat(global: &Global) -> Result<(), CliError> {
    let store = existing_store(global)?;
    let stat = store.stat()?;
    if global.json {
        return print_json(&stat);
    }
    let json = serde_json::to_value(stat).map_err(|error| CliError::failed(error.to_string()))?;
    for (key, value) in json.as_object().into_iter().flatten() {
        print_line(&format!("{:<16} {value}", key.replace('_', " ")));
    }
    Ok(())
}
