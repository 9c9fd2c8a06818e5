//! Results of single keys, to and from a shared store.

use marf_cache::{Digest, Record, Store};

use crate::{
    error::RemoteError,
    lease::{Kind, Lease},
    observer::Observer,
    pull::{self, PullReport},
    push::{self, PushReport},
    remote::Remote,
    survey,
};

impl Remote {
    /// Sends results of keys, and the given blobs, with everything that belongs to them and the shared store lacks. Creates the shared
    /// store if it is absent.
    ///
    /// Conflicts are not an error: the result that is already there stays, and the report lists both.
    ///
    /// # Errors
    /// Returns an error if the shared store cannot be written, or if the local store lacks a result or a blob.
    pub fn send(
        &self,
        store: &Store,
        keys: &[Digest],
        blobs: &[Digest],
        observer: &dyn Observer,
    ) -> Result<PushReport, RemoteError> {
        let work = async {
            self.make().await?;
            push::results(&self.bucket, store, keys, blobs, observer).await
        };
        self.holding(&Lease::new(Kind::Shared), observer, work)
    }

    /// Returns the record of a key, or `None` if it does not exist or its writer is not trusted.
    ///
    /// # Errors
    /// Returns an error if the shared store cannot be read or the record is damaged. An absent shared store
    /// is not an error.
    pub fn record(&self, key: &Digest, observer: &dyn Observer) -> Result<Option<Record>, RemoteError> {
        self.waiting(observer, async {
            match self.check().await {
                Err(RemoteError::Absent { .. }) => return Ok(None),
                checked => checked?,
            }
            let found = survey::record(&self.bucket, key).await?;
            Ok(found
                .filter(|found| found.is_believed)
                .map(|found| found.value.record))
        })
    }

    /// Fetches results of keys with everything that belongs to them and the local store lacks. All must
    /// exist.
    ///
    /// # Errors
    /// Returns an error if the shared store cannot be read or lacks a part of them, or if the local store
    /// cannot be written.
    pub fn bring(
        &self,
        store: &Store,
        keys: &[Digest],
        observer: &dyn Observer,
    ) -> Result<PullReport, RemoteError> {
        self.waiting(observer, async {
            self.check().await?;
            pull::results(&self.bucket, store, keys, &[], observer).await
        })
    }
}
