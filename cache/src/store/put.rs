//! How blobs enter the store.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
};

use super::{LARGE_BYTES, Store, StoreError, lease::Use, write_batch::LargeBlob};
use crate::Digest;

impl Store {
    /// Stores a blob and returns its digest; the same bytes are stored once.
    ///
    /// # Errors
    /// A store that cannot be written; nothing of the blob becomes visible.
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StoreError> {
        let digest = Digest::of(bytes);
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

    /// Stores a file of at most `max_bytes` bytes, as a copy that shares its blocks where the file system can; returns
    /// digest and bytes of what was copied, whatever happens to the file meanwhile.
    ///
    /// # Errors
    /// A file that cannot be read or is longer ([`StoreError::TooLarge`]), and a store that cannot be written.
    pub fn put_file(&self, path: &Path, max_bytes: u64) -> Result<(Digest, Arc<[u8]>), StoreError> {
        let files = &self.objects.files;
        let absent = || StoreError::io("read", path)(std::io::ErrorKind::NotFound.into());
        let bytes = files.meta(path).ok_or_else(absent)?.bytes;
        let fits = |bytes: u64| match bytes > max_bytes {
            true => Err(StoreError::TooLarge {
                path: path.to_owned(),
                bytes,
                max_bytes,
            }),
            false => Ok(()),
        };
        fits(bytes)?;
        if bytes >= LARGE_BYTES as u64
            && let Some(copy) = self.reflink(path)?
        {
            return self.put_copy(copy, fits);
        }
        // One byte more than allowed, so that a file that grew is noticed and never read whole.
        let most = usize::try_from(max_bytes.saturating_add(1)).unwrap_or(usize::MAX);
        let read = files.read_at(path, 0, most)?.ok_or_else(absent)?;
        fits(read.len() as u64)?;
        let read: Arc<[u8]> = Arc::from(read);
        Ok((self.put(&read)?, read))
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
    fn put_copy(
        &self,
        copy: PathBuf,
        fits: impl FnOnce(u64) -> Result<(), StoreError>,
    ) -> Result<(Digest, Arc<[u8]>), StoreError> {
        let files = &self.objects.files;
        let bytes: Arc<[u8]> = Arc::from(files.read(&copy)?.unwrap_or_default());
        let digest = Digest::of(&bytes);
        let checked = fits(bytes.len() as u64).and_then(|()| self.is_stored(&digest));
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

    /// Tells whether a blob is stored or about to be; one that is stored is protected from collections.
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
