//! Results of single keys, to and from a shared store.

use marf_cache::{Digest, Store};

use crate::{
    error::RemoteError,
    lease::{Kind, Lease},
    pull::{self, Pulled},
    push::{self, Pushed},
    remote::{Observer, Remote},
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
    ) -> Result<Pushed, RemoteError> {
        let work = async {
            self.make().await?;
            push::results(&self.bucket, store, keys, blobs, observer).await
        };
        self.holding(&Lease::new(Kind::Shared), observer, work)
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
    ) -> Result<Pulled, RemoteError> {
        self.waiting(observer, async {
            self.check().await?;
            pull::results(&self.bucket, store, keys, &[], observer).await
        })
    }
}
