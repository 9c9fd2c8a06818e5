//! Blobs of a shared store one by one, as a store asks for them that lacks them.

use std::sync::Arc;

use marf_cache::{Digest, Upstream};

use crate::{fetch, observer::Observer, remote::Remote};

/// The blobs of a shared store.
pub struct Reader<O> {
    remote: Arc<Remote>,
    observer: O,
}

impl<O: Observer> Reader<O> {
    /// Returns a reader of the blobs of a shared store. `observer` reports whether the user wants to stop.
    pub fn new(remote: Arc<Remote>, observer: O) -> Self {
        Self { remote, observer }
    }
}

impl<O: Observer + Send> Upstream for Reader<O> {
    fn blob(&self, digest: &Digest) -> Result<Option<Vec<u8>>, String> {
        let read = fetch::blob(&self.remote.bucket, digest);
        let read = self.remote.waiting(&self.observer, read);
        let bytes = read.map_err(|error| error.to_string())?;
        Ok(bytes.map(|bytes| bytes.to_vec()))
    }
}
