//! What servers listed last, kept in the scratch folder: losing it costs requests and never a result.

use std::path::{Path, PathBuf};

use marf_cache::Digest;
use serde::{Serialize, de::DeserializeOwned};

use crate::files;

/// Returns the key of a cached listing.
pub(crate) fn key(kind: &str, name: &str) -> Digest {
    Digest::of(format!("{kind}\n{name}").as_bytes())
}

/// Returns what was written under a key; `None`, where it is lost or of another form.
pub(crate) fn read<T: DeserializeOwned>(scratch: &Path, key: &Digest) -> Option<T> {
    serde_json::from_slice(&std::fs::read(path(scratch, key)).ok()?).ok()
}

/// Writes a listing; where that fails, the next run asks the server again.
pub(crate) fn write<T: Serialize>(scratch: &Path, key: &Digest, value: &T) {
    let path = path(scratch, key);
    let written = serde_json::to_vec(value)
        .map_err(std::io::Error::from)
        .and_then(|bytes| {
            std::fs::create_dir_all(scratch.join("listings"))?;
            files::replace(&path, &bytes)
        });
    drop(written);
}

fn path(scratch: &Path, key: &Digest) -> PathBuf {
    scratch.join("listings").join(format!("{key}.json"))
}
