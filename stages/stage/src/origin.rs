use marf_cache::{Digest, Sha256};
use serde::{Deserialize, Serialize};

/// A file that a source met, and where its bytes came from. Addresses and times are in no key.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Name in the archive, relative, with `/`.
    pub file: String,
    /// What it was taken for.
    pub kind: OriginKind,
    /// Digest of its bytes, or of the reason if it was not read.
    pub blake3: Digest,
    /// Length. Absent if the file was not needed, so that its bytes are not in the store.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// The SHA-256 digest of the bytes, for other programs. Absent if `bytes` is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<Sha256>,
    /// The address that gave it. Absent for a file of this machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
    /// Time of the download, as `YYYY-MM-DDTHH:MM:SSZ`. Absent for a file of this machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fetched: Option<String>,
    /// Why it was not taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Kind of a file of an archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OriginKind {
    /// A picture.
    Photo,
    /// Pixels behind a label.
    Raw,
    /// A PDS4 label.
    Pds4,
    /// A record of a raw-image feed.
    Feed,
    /// A PDS3 label without pixels.
    Odl,
    /// None of these.
    Other,
    /// A file that could not be read.
    Unreadable,
}

impl Origin {
    /// Returns files as bytes: one JSON object a line, in the order given.
    pub fn encode(origins: &[Self]) -> Vec<u8> {
        // Strings, digests and integers always serialise.
        let lines = origins
            .iter()
            .filter_map(|origin| serde_json::to_vec(origin).ok());
        lines.flat_map(|line| [line, vec![b'\n']]).flatten().collect()
    }

    /// Reads what [`Origin::encode`] wrote.
    ///
    /// # Errors
    /// Returns the first line that is not an origin, as an error.
    pub fn decode(bytes: &[u8]) -> Result<Vec<Self>, serde_json::Error> {
        let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
        lines.map(serde_json::from_slice).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn origin(file: &str) -> Origin {
        Origin {
            file: file.to_owned(),
            kind: OriginKind::Photo,
            blake3: Digest::from_content(b"abc"),
            bytes: Some(3),
            sha256: Some(Sha256::from_content(b"abc")),
            url: None,
            fetched: None,
            reason: None,
        }
    }

    #[test]
    fn a_file_is_one_line_and_survives_it() {
        let left = Origin {
            kind: OriginKind::Other,
            bytes: None,
            sha256: None,
            reason: Some("not a photo:\n\"x\"".to_owned()),
            ..origin("notes.txt")
        };
        let origins = vec![origin("a/b.jpg"), left];
        let bytes = Origin::encode(&origins);
        assert_eq!(bytes.iter().filter(|byte| **byte == b'\n').count(), 2);
        assert_eq!(Origin::decode(&bytes).unwrap(), origins);
        assert_eq!(Origin::decode(&[]).unwrap(), []);
        assert!(Origin::decode(b"{\"file\":1}").is_err());
    }
}
