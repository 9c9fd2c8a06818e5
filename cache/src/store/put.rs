//! How blobs enter the store.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
};

use super::{Store, StoreError, lease::Use, write_batch::LargeBlob};
use crate::Digest;

/// Blobs from this length on are files of their own.
const LARGE_BYTES: usize = 64 << 10;

/// A file to store, and the most bytes it may have.
#[derive(Clone, Copy)]
struct Limit<'a> {
    path: &'a Path,
    max_bytes: u64,
}

impl Limit<'_> {
    fn absent(self) -> StoreError {
        StoreError::io("read", self.path)(std::io::ErrorKind::NotFound.into())
    }

    fn check(self, bytes: u64) -> Result<(), StoreError> {
        if bytes > self.max_bytes {
            Err(StoreError::TooLarge {
                path: self.path.to_owned(),
                bytes,
                max_bytes: self.max_bytes,
            })
        } else {
            Ok(())
        }
    }
}

impl Store {
    /// Stores a blob and returns its digest. The same bytes are stored once.
    ///
    /// # Errors
    /// Returns an error if the store cannot be written. Nothing of the blob then becomes visible.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StoreError> {
        let digest = Digest::from_content(bytes);
        if self.is_stored(&digest)? {
            return Ok(digest);
        }
        match bytes.len() {
            0..LARGE_BYTES => self.pending.lock().open.add_small(digest, bytes),
            _ => {
                let path = self.objects.staging()?.next_path();
                self.objects.files.write_new(&path, bytes)?;
                self.add_large(digest, path, bytes.len() as u64)?;
            }
        }
        self.commit_if_due()?;
        Ok(digest)
    }

    /// Stores a file of at most `max_bytes` bytes, as a copy that shares its blocks if the file system can. Returns
    /// digest and bytes of the copy, even if the file changes meanwhile.
    ///
    /// # Errors
    /// A file that cannot be read or is longer ([`StoreError::TooLarge`]), and a store that cannot be written.
    pub fn put_file(&self, path: &Path, max_bytes: u64) -> Result<(Digest, Arc<[u8]>), StoreError> {
        let limit = Limit { path, max_bytes };
        let bytes = self.objects.files.meta(path).ok_or_else(|| limit.absent())?.bytes;
        limit.check(bytes)?;
        if bytes >= LARGE_BYTES as u64
            && let Some(copy) = self.reflink(path)?
        {
            return self.put_copy(copy, limit);
        }
        let read = self.read_within(limit)?;
        Ok((self.put(&read)?, read))
    }

    /// Stores a link to a file of at most `max_bytes` bytes. Returns its current digest and bytes. The bytes stay outside the
    /// store: once the file is changed or gone, the blob is damaged or lost like any other ([`Store::reference`]).
    ///
    /// # Errors
    /// As of [`Store::put_file`], and a file system without symbolic links.
    pub fn put_reference(&self, path: &Path, max_bytes: u64) -> Result<(Digest, Arc<[u8]>), StoreError> {
        let read = self.read_within(Limit { path, max_bytes })?;
        let digest = Digest::from_content(&read);
        if !self.is_stored(&digest)? {
            let link = self.objects.staging()?.next_path();
            self.objects.files.reference(path, &link)?;
            self.add_large(digest, link, read.len() as u64)?;
            self.commit_if_due()?;
        }
        Ok((digest, read))
    }

    fn read_within(&self, limit: Limit<'_>) -> Result<Arc<[u8]>, StoreError> {
        // One byte more than allowed, so that a file that grew is noticed and never read whole.
        let most = usize::try_from(limit.max_bytes.saturating_add(1)).unwrap_or(usize::MAX);
        let read = self.objects.files.read_at(limit.path, 0, most)?;
        let read = read.ok_or_else(|| limit.absent())?;
        limit.check(read.len() as u64)?;
        Ok(Arc::from(read))
    }

    fn reflink(&self, path: &Path) -> Result<Option<PathBuf>, StoreError> {
        if self.has_no_reflinks.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let copy = self.objects.staging()?.next_path();
        if self.objects.files.try_reflink(path, &copy) {
            return Ok(Some(copy));
        }
        self.has_no_reflinks.store(true, Ordering::Relaxed);
        Ok(None)
    }

    /// Stores a temporary file.
    fn put_copy(&self, copy: PathBuf, limit: Limit<'_>) -> Result<(Digest, Arc<[u8]>), StoreError> {
        let files = &self.objects.files;
        let bytes: Arc<[u8]> = Arc::from(files.read(&copy)?.unwrap_or_default());
        let digest = Digest::from_content(&bytes);
        let checked = limit
            .check(bytes.len() as u64)
            .and_then(|()| self.is_stored(&digest));
        match checked {
            Ok(false) if bytes.len() >= LARGE_BYTES => {
                files.seal(&copy)?;
                self.add_large(digest, copy, bytes.len() as u64)?;
                self.commit_if_due()?;
            }
            other => {
                files.remove_file(&copy)?;
                other?;
                // The file was cut since its length was asked.
                self.put(&bytes)?;
            }
        }
        Ok((digest, bytes))
    }

    /// Returns whether a blob is stored or about to be. A stored one is protected from collections.
    fn is_stored(&self, digest: &Digest) -> Result<bool, StoreError> {
        if self.pending.lock().find(|batch| batch.size_of(digest)).is_some() {
            return Ok(true);
        }
        if !self.objects.knows(digest) {
            return Ok(false);
        }
        self.protect(Use::Blob(*digest), || Ok(self.objects.knows(digest)))
    }

    pub(super) fn protect<T>(
        &self,
        used: Use,
        check: impl FnOnce() -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let objects = &self.objects;
        objects
            .lease
            .protect(&[used], &objects.locks, &objects.notices, check)
    }

    fn add_large(&self, digest: Digest, path: PathBuf, bytes: u64) -> Result<(), StoreError> {
        let mut pending = self.pending.lock();
        match pending.find(|batch| batch.size_of(&digest)) {
            None => pending.open.add_large(digest, LargeBlob { path, bytes }),
            // Another thread put the same bytes meanwhile.
            Some(_) => self.objects.files.remove_file(&path)?,
        }
        Ok(())
    }
}
