//! Actions: everything that a result depends on, as one stored object whose digest is the key of the result.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{Digest, canonical_json};

/// Version of the form of actions. It is the first field of each.
pub const ACTION_FORMAT: u32 = 2;

/// Name of the input of a part for something outside the store: the content of a shard in an archive.
pub const FINGERPRINT: &str = "fingerprint";

/// Name of the input of a source: the set of its shards, whose leaves are fingerprints.
pub const LISTING: &str = "listing";

/// Everything that a result depends on: which stage at which version computes it, from what, where.
///
/// [`Action::encode`] gives its one form as bytes, which the store keeps like any blob. The key of a result is the blake3
/// digest of these bytes, so that anyone who has them can compute it again. Cores, memory, time, paths and hosts are in no
/// action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Action {
    /// [`ACTION_FORMAT`].
    pub action: u32,
    /// Name of the stage.
    pub stage: String,
    /// Version of the stage.
    pub version: u32,
    /// The part of the stage's work (`fetch`, `decide`, `fold`). Absent if it is all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<String>,
    /// The shard that the part is about. Absent if it is about no shard.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shard: Option<u32>,
    /// Parameters of the stage, all of them, defaults included.
    pub params: Value,
    /// Digests of the contents it reads, by name.
    pub inputs: BTreeMap<String, Digest>,
    /// The backend that computes it, if results differ from backend to backend (a GPU). Absent on the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<String>,
    /// The stages that its children are of.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub children: BTreeMap<String, ChildVersion>,
}

/// The version and the backend with which children of a node run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChildVersion {
    /// Version of their stage.
    pub version: u32,
    /// Their backend. Absent on the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<String>,
}

/// Bytes that are not an action.
#[derive(Debug, thiserror::Error)]
pub enum ActionError {
    /// The bytes are not the JSON of an action.
    #[error("not an action: {0}")]
    Malformed(#[from] serde_json::Error),
    /// The action is of another form.
    #[error("the action has format {found}, but this program reads format {ACTION_FORMAT}")]
    Format {
        /// Its form.
        found: u32,
    },
    /// The bytes are not in canonical form, so that their digest is not a key.
    #[error("an action that is not in canonical form")]
    NotCanonical,
}

impl Action {
    /// Returns its bytes: canonical JSON ([`canonical_json`]).
    pub fn encode(&self) -> Vec<u8> {
        // Strings, digests, integers and sorted maps always serialise.
        canonical_json(&serde_json::to_value(self).unwrap_or_default())
    }

    /// Returns the key of its result: the digest of its bytes.
    pub fn key(&self) -> Digest {
        Digest::from_content(&self.encode())
    }

    /// Reads what [`Action::encode`] wrote.
    ///
    /// # Errors
    /// Returns an error if the bytes are not an action, have another form, or are not canonical.
    pub fn decode(bytes: &[u8]) -> Result<Self, ActionError> {
        let value: Value = serde_json::from_slice(bytes)?;
        let format = value.get("action").and_then(Value::as_u64).unwrap_or(0);
        if format != u64::from(ACTION_FORMAT) {
            return Err(ActionError::Format {
                found: u32::try_from(format).unwrap_or(u32::MAX),
            });
        }
        let action: Self = serde_json::from_value(value)?;
        if action.encode() == bytes {
            Ok(action)
        } else {
            Err(ActionError::NotCanonical)
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn action() -> Action {
        Action {
            action: ACTION_FORMAT,
            stage: "blur".to_owned(),
            version: 3,
            part: None,
            shard: None,
            params: json!({"min_share": 0.5, "by_hand": {"keep": [], "reject": []}, "tau": 30.0}),
            inputs: BTreeMap::from([("photos".to_owned(), Digest::from_content(b"photos"))]),
            backend: None,
            children: BTreeMap::new(),
        }
    }

    /// Other programs recompute keys from these bytes. They change only with the form.
    #[test]
    fn the_bytes_of_an_action_are_sorted_json_without_white_space() {
        let photos = Digest::from_content(b"photos");
        let expected = format!(
            r#"{{"action":2,"inputs":{{"photos":"{photos}"}},"params":{{"by_hand":{{"keep":[],"reject":[]}},"min_share":0.5,"tau":30}},"stage":"blur","version":3}}"#
        );
        assert_eq!(String::from_utf8(action().encode()).unwrap(), expected);
        assert_eq!(action().key(), Digest::from_content(expected.as_bytes()));
    }

    #[test]
    fn only_the_canonical_bytes_are_read() {
        let bytes = action().encode();
        assert_eq!(Action::decode(&bytes).unwrap().encode(), bytes);
        let spaced = String::from_utf8(bytes.clone()).unwrap().replace(':', ": ");
        assert!(matches!(
            Action::decode(spaced.as_bytes()),
            Err(ActionError::NotCanonical)
        ));
        let newer = String::from_utf8(bytes)
            .unwrap()
            .replace("\"action\":2", "\"action\":3");
        let error = Action::decode(newer.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("format 3"), "{error}");
        assert!(Action::decode(b"{").is_err());
    }
}
