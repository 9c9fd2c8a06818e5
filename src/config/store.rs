//! `[store]`: where results are shared. It is part of no key.

use serde_json::{Value as Json, json};

use super::error::ConfigError;
use super::syntax::Located;
use crate::nearest::did_you_mean;

/// The table.
pub(super) const TABLE: &str = "store";
const REMOTE: &str = "remote";

/// Returns the address of the shared store; none if the pipeline has none.
///
/// # Errors
/// Another key than `remote`, or something that is no address.
pub(super) fn remote(root: &Located) -> Result<Option<String>, ConfigError> {
    let Some(table) = root.entry(TABLE) else {
        return Ok(None);
    };
    let shape = || {
        Some(format!(
            "write it as `[{TABLE}]` with `{REMOTE} = \"s3://BUCKET/PREFIX\"`"
        ))
    };
    let Some(entries) = table.value.entries() else {
        let message = format!("`{TABLE}` is not a table");
        return Err(ConfigError::at(table.at.clone(), message).hint(shape()));
    };
    if let Some(entry) = entries.iter().find(|entry| entry.key != REMOTE) {
        let message = format!("unknown key `{}` in `[{TABLE}]`", entry.key);
        let hint = did_you_mean(&entry.key, [REMOTE]).or_else(shape);
        return Err(ConfigError::at(entry.at.clone(), message).hint(hint));
    }
    let Some(entry) = entries.first() else {
        return Ok(None);
    };
    let refuse = |message: String, hint| Err(ConfigError::at(entry.value.at.clone(), message).hint(hint));
    let Some(url) = entry.value.text() else {
        return refuse(format!("`{REMOTE}` must be a string"), shape());
    };
    match marf_remote::check_address(url) {
        Ok(()) => Ok(Some(url.to_owned())),
        Err(error) => refuse(error.to_string(), error.hint()),
    }
}

/// Returns the schema of the table.
pub(super) fn schema() -> Json {
    json!({
        "type": "object",
        "description": "Where results are shared with other machines; part of no key.",
        "properties": {
            REMOTE: {
                "type": "string",
                "description": "Address of the shared store: `s3://BUCKET/PREFIX` or `file:///FOLDER`.",
                "pattern": "^(s3://[^/@?#]+|file:///[^@?#])",
            },
        },
        "additionalProperties": false,
    })
}
