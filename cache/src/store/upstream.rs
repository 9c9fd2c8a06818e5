//! A place that has blobs which a store lacks.

use std::sync::Arc;

use super::{Store, StoreError};
use crate::Digest;

/// Has blobs that a store may lack.
pub trait Upstream: Send + Sync {
    /// Returns a blob, or `None` if it does not exist. The store checks its digest.
    ///
    /// # Errors
    /// The reason why the upstream cannot be read, in a sentence.
    fn blob(&self, digest: &Digest) -> Result<Option<Vec<u8>>, String>;
}

impl Store {
    /// Returns the store with a place from which it gets blobs that are asked for and that it lacks, and then has.
    #[must_use]
    pub fn with_upstream(self, upstream: Arc<dyn Upstream>) -> Self {
        Self {
            upstream: Some(upstream),
            ..self
        }
    }

    /// Gets a blob from upstream, or returns `None` if it does not exist there either.
    pub(super) fn get_upstream(&self, digest: &Digest) -> Result<Option<Arc<[u8]>>, StoreError> {
        let Some(upstream) = &self.upstream else {
            return Ok(None);
        };
        let unfetched = |message: String| StoreError::Upstream {
            digest: *digest,
            message,
        };
        let Some(bytes) = upstream.blob(digest).map_err(unfetched)? else {
            return Ok(None);
        };
        if Digest::from_content(&bytes) != *digest {
            return Err(unfetched(format!("{} bytes of another digest came", bytes.len())));
        }
        self.put(&bytes)?;
        Ok(Some(Arc::from(bytes)))
    }
}
