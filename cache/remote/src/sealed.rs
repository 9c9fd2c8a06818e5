//! Small JSON objects that are not named by their digest: the digest of the JSON stands in a line before it.

use bytes::Bytes;
use marf_cache::{Digest, Record};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// The record of a key, with what belongs to it: whoever reads it need not read the objects to know what they name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct RemoteRecord {
    pub(crate) record: Record,
    /// Blobs of this result alone.
    pub(crate) blobs: Vec<Digest>,
    /// Keys of its parts and children.
    pub(crate) keys: Vec<Digest>,
}

/// A run, with the results and documents it consists of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemoteRun {
    /// Name of its pipeline.
    pub pipeline: String,
    /// Start, in seconds since 1970.
    pub started_unix_s: u64,
    /// Keys of its results.
    pub keys: Vec<Digest>,
    /// Blobs that it names beside them.
    pub blobs: Vec<Digest>,
    /// The run's root, a JSON text, to the byte.
    pub root: String,
}

/// Returns a value as JSON behind its digest.
pub(crate) fn seal(value: &impl Serialize) -> Bytes {
    // Strings, numbers and sorted maps always serialise.
    let json = serde_json::to_vec(value).unwrap_or_default();
    let mut bytes = format!("{}\n", Digest::of(&json)).into_bytes();
    bytes.extend(json);
    Bytes::from(bytes)
}

/// Reads what [`seal`] wrote; none if it is not whole.
pub(crate) fn open<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    let (line, json) = (bytes.get(..end)?, bytes.get(end + 1..)?);
    let digest: Digest = std::str::from_utf8(line).ok()?.parse().ok()?;
    (Digest::of(json) == digest).then(|| serde_json::from_slice(json).ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sealed_value_comes_back_whole_or_not_at_all() {
        let run = RemoteRun {
            pipeline: "mars\n".to_owned(),
            started_unix_s: 7,
            keys: vec![Digest::of(b"key")],
            blobs: Vec::new(),
            root: "{}".to_owned(),
        };
        let bytes = seal(&run);
        assert_eq!(open(&bytes), Some(run));
        for at in 0..bytes.len() {
            let mut flipped = bytes.to_vec();
            flipped[at] ^= 1;
            assert_eq!(open::<RemoteRun>(&flipped), None, "flipped at {at}");
            assert_eq!(open::<RemoteRun>(&bytes[..at]), None, "cut at {at}");
        }
    }
}
