//! Names of objects in a shared store.

use marf_cache::{Digest, file::FileKind};

/// Object with the format of the shared store.
pub(crate) const FORMAT: &str = "format";
/// Folder of large blobs.
pub(crate) const BLOBS: &str = "cas";
/// Folder of packs and their indexes.
pub(crate) const PACKS: &str = "packs";
/// Folder of records.
pub(crate) const RECORDS: &str = "records";
/// Folder of runs.
pub(crate) const RUNS: &str = "runs";
/// Folder of leases.
pub(crate) const LEASES: &str = "leases";

/// Ending of a pack.
const PACK: &str = ".pack";
/// Ending of an index.
const INDEX: &str = ".idx";

/// Returns the largest size of an object that is read, bytes.
pub(crate) fn most_bytes(name: &str) -> u64 {
    let kind = match name.split('/').next() {
        Some(BLOBS) => FileKind::State,
        Some(LEASES | FORMAT) => FileKind::Key,
        _ => FileKind::Document,
    };
    kind.max_bytes()
}

/// Returns the name of a large blob.
pub(crate) fn blob(digest: &Digest) -> String {
    in_folder(BLOBS, digest)
}

/// Returns the name of the record of a key.
pub(crate) fn record(key: &Digest) -> String {
    in_folder(RECORDS, key)
}

fn in_folder(folder: &str, digest: &Digest) -> String {
    let hex = digest.to_string();
    let (first, rest) = hex.split_at(2);
    format!("{folder}/{first}/{rest}")
}

/// Returns the digest in a name that [`blob`] or [`record`] made, or `None` for others.
pub(crate) fn digest_in(name: &str) -> Option<Digest> {
    let mut parts = name.rsplit('/');
    let (rest, first) = (parts.next()?, parts.next()?);
    format!("{first}{rest}").parse().ok()
}

/// Returns the name of a pack.
pub(crate) fn pack(pack: &Digest) -> String {
    format!("{PACKS}/{pack}{PACK}")
}

/// Returns the name of the index of a pack.
pub(crate) fn index(pack: &Digest) -> String {
    format!("{PACKS}/{pack}{INDEX}")
}

/// Returns the pack whose index has this name, or `None` for other names.
pub(crate) fn pack_of_index(name: &str) -> Option<Digest> {
    in_packs(name, INDEX)
}

/// Returns the pack of this name, or `None` for other names.
pub(crate) fn pack_in(name: &str) -> Option<Digest> {
    in_packs(name, PACK)
}

fn in_packs(name: &str, ending: &str) -> Option<Digest> {
    name.strip_prefix(PACKS)?
        .strip_prefix('/')?
        .strip_suffix(ending)?
        .parse()
        .ok()
}

/// Returns the folder of the runs of a pipeline: its name may have any letters.
pub(crate) fn runs_of(pipeline: &str) -> String {
    let digest = Digest::from_content(pipeline.as_bytes()).to_string();
    format!("{RUNS}/{}", digest.get(..16).unwrap_or_default())
}

/// Returns the name of a run, so that names sort by time.
pub(crate) fn run(pipeline: &str, started_unix_s: u64, root: &Digest) -> String {
    format!("{}/{started_unix_s:012}-{root}.json", runs_of(pipeline))
}

/// Returns start and root of a run from its name, or `None` for other names.
pub(crate) fn run_in(name: &str) -> Option<(u64, Digest)> {
    let (started, root) = name.rsplit('/').next()?.strip_suffix(".json")?.split_once('-')?;
    Some((started.parse().ok()?, root.parse().ok()?))
}
