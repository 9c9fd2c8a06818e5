//! `[store]`: where results are shared. It is not part of any key.

use std::path::{Path, PathBuf};

use serde_json::{Value as Json, json};

use super::error::ConfigError;
use super::syntax::SyntaxNode;
use crate::nearest::did_you_mean;

/// The table.
pub(super) const TABLE: &str = "store";
const REMOTE: &str = "remote";
const VERIFY_SHARE: &str = "verify_share";
const TRUST: &str = "trust";

/// Where results are shared, and which of them are trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedStore {
    /// Address of the shared store.
    pub url: String,
    /// Share of the results of others that are made again and compared, 0 to 1.
    pub verify_share: f64,
    /// Files with the public keys of trusted writers. If empty, everybody is trusted.
    pub trust: Vec<PathBuf>,
}

/// Returns the shared store, or `None` if the pipeline has no shared store.
///
/// # Errors
/// Returns an error for an unknown key, an invalid address or an invalid share.
pub(super) fn shared(root: &SyntaxNode, base: &Path) -> Result<Option<SharedStore>, ConfigError> {
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
    let (mut url, mut verify_share, mut trust) = (None, 0.0, Vec::new());
    for entry in entries {
        match entry.key.as_str() {
            REMOTE => url = Some(address(&entry.value, shape())?),
            VERIFY_SHARE => verify_share = share(&entry.value)?,
            TRUST => trust = key_files(&entry.value, base)?,
            key => {
                let message = format!("unknown key `{key}` in `[{TABLE}]`");
                let hint = did_you_mean(key, [REMOTE, VERIFY_SHARE, TRUST]).or_else(shape);
                return Err(ConfigError::at(entry.at.clone(), message).hint(hint));
            }
        }
    }
    if url.is_none() && !entries.is_empty() {
        let message = format!("`[{TABLE}]` needs `{REMOTE}`, the address of the shared store");
        return Err(ConfigError::at(table.at.clone(), message).hint(shape()));
    }
    Ok(url.map(|url| SharedStore {
        url,
        verify_share,
        trust,
    }))
}

fn address(value: &SyntaxNode, shape: Option<String>) -> Result<String, ConfigError> {
    let refuse = |message: String, hint| Err(ConfigError::at(value.at.clone(), message).hint(hint));
    let Some(url) = value.text() else {
        return refuse(format!("`{REMOTE}` must be a string"), shape);
    };
    match marf_remote::check_address(url) {
        Ok(()) => Ok(url.to_owned()),
        Err(error) => refuse(error.to_string(), error.hint()),
    }
}

/// Returns the files that a list names, from the folder of the pipeline.
fn key_files(value: &SyntaxNode, base: &Path) -> Result<Vec<PathBuf>, ConfigError> {
    let shape = || {
        let message = format!("`{TRUST}` must be a list of files with public keys, at least one");
        ConfigError::at(value.at.clone(), message).hint(Some(format!("`{TRUST} = [\"PUB.pem\"]`")))
    };
    let json = value.json();
    let files = json
        .as_array()
        .filter(|files| !files.is_empty())
        .ok_or_else(shape)?;
    let file = |file: &Json| Some(base.join(file.as_str()?));
    files.iter().map(file).collect::<Option<_>>().ok_or_else(shape)
}

fn share(value: &SyntaxNode) -> Result<f64, ConfigError> {
    let number = value.json().as_f64().filter(|share| (0.0..=1.0).contains(share));
    number.ok_or_else(|| {
        ConfigError::at(
            value.at.clone(),
            format!("`{VERIFY_SHARE}` must be a number from 0 to 1"),
        )
    })
}

/// Returns the schema of the table.
pub(super) fn schema() -> Json {
    json!({
        "type": "object",
        "description": "Where results are shared with other machines. Not part of any key.",
        "properties": {
            REMOTE: {
                "type": "string",
                "description": "Address of the shared store: `s3://BUCKET/PREFIX` or `file:///FOLDER`.",
                "pattern": "^(s3://[^/@?#]+|file:///[^@?#])",
            },
            VERIFY_SHARE: {
                "type": "number",
                "description": "Share of the results of others that a run computes again and compares. Each run takes a different sample.",
                "minimum": 0,
                "maximum": 1,
                "default": 0,
            },
            TRUST: {
                "type": "array",
                "description": "Files with the public keys (Ed25519, PEM) of trusted writers. Without it everybody is trusted.",
                "items": { "type": "string" },
                "minItems": 1,
            },
        },
        "additionalProperties": false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GlobalOptions, check};

    fn shared(table: &str) -> Result<Option<SharedStore>, String> {
        let text =
            format!("[archive.demo]\nkind = \"demo\"\n[node.extract]\narchive = \"demo\"\n[store]\n{table}");
        let checked = check(&text, &[], &GlobalOptions::default(), Path::new(""));
        checked
            .map(|pipeline| pipeline.shared)
            .map_err(|error| error.message)
    }

    #[test]
    fn a_share_to_verify_is_a_number_from_0_to_1() {
        let with = |share: &str| shared(&format!("remote = \"file:///s\"\n{share}"));
        let share = |text: &str| with(text).unwrap().unwrap().verify_share;
        assert_eq!(share(""), 0.0);
        assert_eq!(share("verify_share = 0.02"), 0.02);
        assert_eq!(share("verify_share = 1"), 1.0);
        for bad in ["1.5", "-0.1", "\"all\""] {
            let message = with(&format!("verify_share = {bad}")).unwrap_err();
            assert_eq!(message, "`verify_share` must be a number from 0 to 1", "{bad}");
        }
        let alone = shared("verify_share = 0.5").unwrap_err();
        assert_eq!(alone, "`[store]` needs `remote`, the address of the shared store");
        assert_eq!(shared(""), Ok(None));
    }

    #[test]
    fn trusted_keys_are_files_beside_the_pipeline() {
        let with = |line: &str| shared(&format!("remote = \"file:///s\"\n{line}"));
        let trust = with("trust = [\"a.pem\", \"/keys/b.pem\"]")
            .unwrap()
            .unwrap()
            .trust;
        assert_eq!(trust, [Path::new("a.pem"), Path::new("/keys/b.pem")]);
        for bad in ["[]", "\"a.pem\"", "[1]"] {
            let message = with(&format!("trust = {bad}")).unwrap_err();
            assert!(
                message.starts_with("`trust` must be a list of files"),
                "{bad}: {message}"
            );
        }
    }
}
