//! Results that other machines have made: a second level of the store.

use marf_cache::{Digest, Record, Store, StoreError};

/// A store that several machines share.
///
/// The engine asks it before it makes what the own store lacks, and tells it what it has made. Whatever goes wrong there is
/// told by the implementation and is no error of a run: what is not fetched is made.
pub trait SharedResults: std::fmt::Debug + Send + Sync {
    /// Fetches the results of keys that are there into the own store, where they are committed when this returns.
    fn fetch(&self, keys: &[Digest]);

    /// Returns what is recorded there of a key, without the result itself; none if it is not there, or nobody answers.
    fn record(&self, key: &Digest) -> Option<Record>;

    /// Sends the result of a key, which is committed, beside the run.
    fn offer(&self, key: &Digest);
}

/// Fetches those results of keys that the own store lacks.
pub(crate) fn fetch_lacking(
    shared: Option<&dyn SharedResults>,
    store: &Store,
    keys: impl Iterator<Item = Digest>,
) -> Result<(), StoreError> {
    let Some(shared) = shared else { return Ok(()) };
    let mut lacking = Vec::new();
    for key in keys {
        if store.hit(&key)?.is_none() {
            lacking.push(key);
        }
    }
    if !lacking.is_empty() {
        shared.fetch(&lacking);
    }
    Ok(())
}
