//! Results that other machines have made: a second level of the store.

use marf_cache::{Digest, Record, Store, StoreError};

/// A store that several machines share.
///
/// The engine asks it for results that the local store lacks, and offers it new results. The implementation reports its errors. They do not
/// fail a run: a result that is not fetched is computed.
pub trait SharedResults: std::fmt::Debug + Send + Sync {
    /// Fetches the available results of keys into the local store, where they are committed when this returns.
    fn fetch(&self, keys: &[Digest]);

    /// Returns the shared record of a key, without the result itself. None if the store has no record or does not answer.
    fn record(&self, key: &Digest) -> Option<Record>;

    /// Sends the result of a key, which is committed, in the background.
    fn offer(&self, key: &Digest);
}

/// Fetches the results of keys that the local store lacks.
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
