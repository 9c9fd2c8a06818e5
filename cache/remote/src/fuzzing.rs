//! Entry point of a fuzzer. Not part of the public interface.

use marf_cache::Digest;
use serde::de::DeserializeOwned;

use crate::pack::decode_index;
use crate::sealed::{self, RemoteRecord, RemoteRun};
use crate::trust::Trust;

/// Reads an index of a pack, a record and a run, each sealed with its right digest. Returns how much of them there is.
pub fn pack(bytes: &[u8]) -> usize {
    let digest = Digest::from_content(bytes);
    let entries = decode_index(&[bytes, digest.as_bytes()].concat()).unwrap_or_default();
    let blobs = entries.iter().filter_map(|entry| entry.bytes_in(bytes));
    let line = [format!("{digest}\n").as_bytes(), bytes].concat();
    entries.len()
        + blobs.map(<[u8]>::len).sum::<usize>()
        + opened::<RemoteRecord>(&line)
        + opened::<RemoteRun>(&line)
}

fn opened<T: DeserializeOwned>(bytes: &[u8]) -> usize {
    usize::from(sealed::open::<T>(bytes, &Trust::default()).is_some())
}
