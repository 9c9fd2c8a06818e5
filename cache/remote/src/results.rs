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
    /// Sends results of keys, and blobs beside them, with all that belongs to them and the shared store lacks; makes the shared store if it
    /// is absent.
    ///
    /// Conflicts are no error: the result that was there first stays, and the answer tells both.
    ///
    /// # Errors
    /// A shared store that cannot be written; a result or a blob that the own store lacks.
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

    /// Returns the record of a key; none if it is not there, or of somebody who is not trusted.
    ///
    /// # Errors
    /// A shared store that cannot be read; one that is absent is none. A record that is damaged.
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

    /// Fetches results of keys with all that belongs to them and the own store lacks. All must be there.
    ///
    /// # Errors
    /// A shared store that cannot be read, or lacks something of them; an own store that cannot be written.
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
