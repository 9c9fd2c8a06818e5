//! Blobs of a shared store one by one, as a store asks for them that lacks them.

use std::sync::Arc;

use marf_cache::{Digest, Upstream};
use parking_lot::Mutex;

use crate::{
    catalogue::{Catalogue, Place},
    error::RemoteError,
    names,
    remote::{Observer, Remote},
};

/// The blobs of a shared store.
pub struct Reader<O> {
    remote: Arc<Remote>,
    observer: O,
    /// Where the small ones are, once that was asked for.
    catalogue: Mutex<Option<Arc<Catalogue>>>,
}

impl<O: Observer> Reader<O> {
    /// Returns the blobs of a shared store; `observer` tells whether the user wants to stop.
    pub fn new(remote: Arc<Remote>, observer: O) -> Self {
        Self {
            remote,
            observer,
            catalogue: Mutex::default(),
        }
    }

    fn read(&self, digest: &Digest) -> Result<Option<Vec<u8>>, RemoteError> {
        let known = self.catalogue.lock().clone();
        let catalogue = match known {
            Some(catalogue) => catalogue,
            None => self.load()?,
        };
        if let Some(bytes) = self.packed(&catalogue, digest)? {
            return Ok(Some(bytes));
        }
        if let Some(bytes) = self.loose(digest)? {
            return Ok(Some(bytes));
        }
        // Packs may have come since, or were joined.
        self.packed(&*self.load()?, digest)
    }

    /// Fetches where the small blobs are.
    fn load(&self) -> Result<Arc<Catalogue>, RemoteError> {
        let catalogue = self
            .remote
            .waiting(&self.observer, Catalogue::load(&self.remote.bucket))?;
        let catalogue = Arc::new(catalogue);
        *self.catalogue.lock() = Some(Arc::clone(&catalogue));
        Ok(catalogue)
    }

    fn packed(&self, catalogue: &Catalogue, digest: &Digest) -> Result<Option<Vec<u8>>, RemoteError> {
        let Some(Place { entry, pack }) = catalogue.find(digest) else {
            return Ok(None);
        };
        let Some(pack) = catalogue.packs.get(pack as usize) else {
            return Ok(None);
        };
        let range = entry.offset..entry.offset + u64::from(entry.len);
        let name = names::pack(pack);
        let read = self.remote.bucket.get_ranges(&name, std::slice::from_ref(&range));
        let parts = self.remote.waiting(&self.observer, read)?;
        Ok(parts.and_then(|parts| parts.first().map(|bytes| bytes.to_vec())))
    }

    fn loose(&self, digest: &Digest) -> Result<Option<Vec<u8>>, RemoteError> {
        let name = names::blob(digest);
        let bytes = self
            .remote
            .waiting(&self.observer, self.remote.bucket.get(&name))?;
        Ok(bytes.map(|bytes| bytes.to_vec()))
    }
}

impl<O: Observer + Send> Upstream for Reader<O> {
    fn blob(&self, digest: &Digest) -> Result<Option<Vec<u8>>, String> {
        self.read(digest).map_err(|error| error.to_string())
    }
}
