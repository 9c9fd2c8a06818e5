use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::Digest;

/// The result of one action: its key, its outputs, everything these may name, and metadata that no key depends on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Digest of the bytes of its [`crate::Action`], which are in the store.
    pub key: Digest,
    /// Name of the stage.
    pub stage: String,
    /// Output blobs by name.
    pub outputs: BTreeMap<String, Output>,
    /// A blob with the digests of all other blobs that the work stored ([`digest_list`]). Absent if there are no
    /// such blobs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub needs: Option<Digest>,
    /// Keys of the parts of the work by shard, as a set ([`crate::manifest::Root`] with keys for leaves).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parts: Option<Digest>,
    /// Keys of the child nodes, by their names below this one.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub children: BTreeMap<String, Digest>,
    /// A blob that lists the files that a source read and where they came from, one JSON object a line. It holds
    /// addresses and times, so no key depends on it, and it is never compared. It is in `needs` too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub origins: Option<Digest>,
    /// Metadata of the computation, never compared.
    pub metadata: RunMetadata,
}

/// A blob that an action made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Its digest.
    pub digest: Digest,
    /// Its length in bytes.
    pub bytes: u64,
}

/// Time, memory, device and program of the run that made a record. No output depends on them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RunMetadata {
    /// Wall time.
    pub seconds: f64,
    /// Peak memory of the whole program up to the end of the action, in MB, or 0 if the system does not
    /// report it.
    pub peak_mb: u64,
    /// Start, in seconds since 1970.
    pub started_unix_s: u64,
    /// Device: `cpu`, or adapter, driver and interface of a GPU.
    pub device: String,
    /// Program with version and commit.
    pub program: String,
    /// Figures of the work by name (`photos`, `rejected`, `measured`).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub counts: BTreeMap<String, u64>,
    /// Seconds of parts of the work by name (`training`), if the stage measures them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parts_s: BTreeMap<String, f64>,
}

/// Two different results for one key.
///
/// The first is kept, unless its outputs were lost: then the second replaces it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Conflict {
    /// The key both have.
    pub key: Digest,
    /// Name of the stage.
    pub stage: String,
    /// The result that stays.
    pub kept: BTreeMap<String, Output>,
    /// The result that differs from it and is not used.
    pub refused: BTreeMap<String, Output>,
    /// True if the result that stays came second, because outputs of the first were lost.
    pub replaced: bool,
}

/// Sizes of a store.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct StoreStat {
    /// Blobs of 64 KiB and more, each a file.
    pub loose_blobs: u64,
    /// Their bytes.
    pub loose_bytes: u64,
    /// Blobs that are links to files outside the store.
    pub references: u64,
    /// The bytes of these files.
    pub referenced_bytes: u64,
    /// Pack files.
    pub packs: u64,
    /// Blobs in packs.
    pub packed_blobs: u64,
    /// Their bytes.
    pub packed_bytes: u64,
    /// Records.
    pub records: u64,
    /// Memos.
    pub memos: u64,
    /// Runs.
    pub runs: u64,
    /// Bytes of the index file and its log.
    pub index_bytes: u64,
    /// Damaged files and objects in quarantine, under `bad/`.
    #[serde(rename = "set_aside")]
    pub quarantined: u64,
}

impl Record {
    /// Returns the JSON kept in a pack.
    pub(super) fn encode(&self) -> Vec<u8> {
        // Strings, numbers and sorted maps always serialise.
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Reads what [`Record::encode`] wrote.
    pub(super) fn decode(json: &[u8]) -> Option<Self> {
        serde_json::from_slice(json).ok()
    }

    /// Returns the blobs that a record is of no use without: outputs, list of needs, set of parts.
    pub(super) fn objects(&self) -> impl Iterator<Item = Digest> {
        let outputs = self.outputs.values().map(|output| output.digest);
        outputs.chain(self.needs).chain(self.parts)
    }
}

/// Returns digests as bytes, 32 each, sorted, each once: the form of [`Record::needs`].
pub fn digest_list(digests: &[Digest]) -> Vec<u8> {
    let sorted: BTreeSet<&Digest> = digests.iter().collect();
    sorted.into_iter().flat_map(|digest| *digest.as_bytes()).collect()
}

/// Reads a list that [`digest_list`] wrote, or returns `None` if the bytes are not sorted digests.
pub fn read_digest_list(bytes: &[u8]) -> Option<Vec<Digest>> {
    let (digests, rest) = bytes.as_chunks::<32>();
    let digests: Vec<Digest> = digests.iter().copied().map(Digest::from_bytes).collect();
    (rest.is_empty() && digests.is_sorted_by(|a, b| a < b)).then_some(digests)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_digests_is_sorted_and_holds_each_once() {
        let mut digests: Vec<Digest> = (0..9_u8).map(|value| Digest::from_content(&[value])).collect();
        digests.push(digests[3]);
        let bytes = digest_list(&digests);
        assert_eq!(bytes.len(), 9 * 32);
        digests.pop();
        digests.sort_unstable();
        assert_eq!(read_digest_list(&bytes), Some(digests));
        assert_eq!(read_digest_list(&[]), Some(Vec::new()));
    }

    #[test]
    fn bytes_that_are_no_sorted_list_are_refused() {
        let bytes = digest_list(&[Digest::from_content(b"a"), Digest::from_content(b"b")]);
        assert_eq!(read_digest_list(&bytes[1..]), None);
        let (first, second) = bytes.split_at(32);
        assert_eq!(read_digest_list(&[second, first].concat()), None);
        assert_eq!(read_digest_list(&[first, first].concat()), None);
    }
}
