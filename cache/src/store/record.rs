use std::collections::BTreeMap;

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
    /// A blob with the digests of all other blobs that the work stored ([`digest_list`]); absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub needs: Option<Digest>,
    /// Keys of the parts of the work by shard, as a set ([`crate::manifest::Root`] with keys for leaves).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parts: Option<Digest>,
    /// Keys of the child nodes, by their names below this one.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub children: BTreeMap<String, Digest>,
    /// How the run went; never compared.
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

/// Time, memory, device and program of the run that made a record; no output depends on them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RunMetadata {
    /// Wall time.
    pub seconds: f64,
    /// Peak memory of the whole program up to the end of the action, in MB; 0 where the system does not tell.
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
}

/// Returns the bytes of a list of digests: sorted, each once, 32 bytes each.
pub fn digest_list(digests: &[Digest]) -> Vec<u8> {
    let sorted: std::collections::BTreeSet<&Digest> = digests.iter().collect();
    sorted.into_iter().flat_map(|digest| *digest.as_bytes()).collect()
}

/// Reads what [`digest_list`] wrote; none if the bytes are no such list.
pub fn read_digest_list(bytes: &[u8]) -> Option<Vec<Digest>> {
    let (chunks, rest) = bytes.as_chunks::<32>();
    let digests: Vec<Digest> = chunks.iter().map(|bytes| Digest::from_bytes(*bytes)).collect();
    (rest.is_empty() && digests.is_sorted_by(|a, b| a < b)).then_some(digests)
}

/// Two results for one key: the first is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Conflict {
    /// The key both have.
    pub key: Digest,
    /// Name of the stage.
    pub stage: String,
    /// The result that stays.
    pub kept: BTreeMap<String, Output>,
    /// The result that came second and differs.
    pub refused: BTreeMap<String, Output>,
}

/// Sizes of a store.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct StoreStat {
    /// Blobs of 64 KiB and more, each a file.
    pub loose_blobs: u64,
    /// Their bytes.
    pub loose_bytes: u64,
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
    /// Bytes of the index file.
    pub index_bytes: u64,
    /// Damaged blobs in quarantine, under `bad/`.
    #[serde(rename = "set_aside")]
    pub quarantined: u64,
}

impl Record {
    /// Returns the bytes stored in the index: the digest of the JSON, then the JSON.
    pub(super) fn encode(&self) -> Vec<u8> {
        // Strings, numbers and sorted maps always serialise.
        let json = serde_json::to_vec(self).unwrap_or_default();
        let mut bytes = Digest::of(&json).as_bytes().to_vec();
        bytes.extend_from_slice(&json);
        bytes
    }

    /// Reads what [`Record::encode`] wrote; none if the bytes are damaged.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (checksum, json) = bytes.split_at_checked(32)?;
        if Digest::of(json).as_bytes() != checksum {
            return None;
        }
        serde_json::from_slice(json).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stores of 0.1.0 hold records of exactly these bytes.
    #[test]
    fn the_bytes_of_a_record_do_not_change() {
        let digest = Digest::of(b"output");
        let json = format!(
            r#"{{"key":"{key}","stage":"blur","version":1,"manifest":"stage = \"blur\"\n","outputs":{{"photos":{{"digest":"{digest}","bytes":6}}}},"circumstances":{{"seconds":0.5,"peak_mb":3,"started_unix_s":7,"device":"cpu","program":"marf 0.1.0"}}}}"#,
            key = Digest::of(b"key"),
        );
        let bytes = [Digest::of(json.as_bytes()).as_bytes(), json.as_bytes()].concat();
        let record = Record::decode(&bytes).unwrap();
        assert_eq!(record.metadata.program, "marf 0.1.0");
        assert_eq!(record.encode(), bytes);
    }
}
