//! Errors of keys at their place in pipeline.toml.

use marf_stage::{ParamError, from_json};
use serde::de::DeserializeOwned;

use super::error::ConfigError;
use super::syntax::Entry;
use crate::nearest::near_word;

/// Returns the error of a key of a table, at its place. `owner` is the name of the table in the message, `path` is below the table.
pub(super) fn placed(owner: &str, table: &Entry, path: &str, message: &str) -> ConfigError {
    let (at, key) = match path {
        "" => (table.at.clone(), String::new()),
        path => (table.value.place(path), format!(".{path}")),
    };
    ConfigError::at(at, format!("{owner}{key}: {message}")).hint(near_word(message))
}

/// Reads a table of the whole pipeline. `shape` is the hint of an error without a nearer one.
///
/// # Errors
/// Anything but a table, and a key that is unknown or whose value has another type.
pub(super) fn read<T: DeserializeOwned>(table: &Entry, shape: &str) -> Result<T, ConfigError> {
    // serde would read the fields of a struct from a list, too.
    if table.value.entries().is_none() {
        let message = format!("`{}` is not a table", table.key);
        return Err(ConfigError::at(table.at.clone(), message).hint(Some(shape.to_owned())));
    }
    from_json(table.value.json()).map_err(|error: ParamError| {
        let error = placed(&table.key, table, &error.path, &error.message);
        let hint = error.hint.clone().or_else(|| Some(shape.to_owned()));
        error.hint(hint)
    })
}
