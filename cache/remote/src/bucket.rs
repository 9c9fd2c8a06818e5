//! Requests: what is read and written behind an address, each as one object by its name.

use std::{
    future::Future,
    io::ErrorKind,
    ops::Range,
    path::PathBuf,
    sync::atomic::{AtomicU64, Ordering},
    time::SystemTime,
};

use bytes::Bytes;
use futures_util::TryStreamExt;
use marf_cache::{
    Digest,
    file::{self, Links},
};
use object_store::{
    Error, GetOptions, GetRange, GetResult, OBJECT_STORE_COALESCE_DEFAULT, ObjectMeta, ObjectStore,
    ObjectStoreExt, PutMode, PutOptions, PutPayload, coalesce_ranges, path::Path,
};
use tokio::{sync::Mutex, time::timeout};

use crate::{
    address::{Address, Patience},
    error::{RemoteError, cause_of},
    names,
    pack::{Catalogue, Pack},
    threads::{FOLDER_PATIENCE, folder_patience, unblocked},
    trust::Trust,
};

/// Requests and bytes since a shared store was opened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct Traffic {
    /// Requests. An attempt that is repeated counts once.
    pub requests: u64,
    /// Bytes sent.
    pub sent_bytes: u64,
    /// Bytes received.
    pub received_bytes: u64,
}

/// An object in a listing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct StoredObject {
    pub(crate) name: String,
    pub(crate) bytes: u64,
    /// By the clock of the server.
    pub(crate) modified: SystemTime,
}

/// What is behind an address.
pub(crate) struct Bucket {
    /// The address, for people.
    pub(crate) place: String,
    /// Signing key, and writers of trusted records and runs.
    pub(crate) trust: Trust,
    root: Path,
    objects: Box<dyn ObjectStore>,
    /// The folder that it is, if it is one.
    folder: Option<PathBuf>,
    /// Known packs and their entries.
    pub(crate) catalogue: Mutex<Catalogue>,
    requests: AtomicU64,
    sent_bytes: AtomicU64,
    received_bytes: AtomicU64,
}

impl Bucket {
    pub(crate) fn open(url: &str, patience: Patience, trust: Trust) -> Result<Self, RemoteError> {
        let address = Address::parse(url)?;
        let (objects, root) = address.open(url, patience)?;
        Ok(Self {
            place: url.to_owned(),
            trust,
            root,
            objects,
            folder: match address {
                Address::Folder(folder) => Some(folder),
                Address::S3 { .. } => None,
            },
            catalogue: Mutex::default(),
            requests: AtomicU64::new(0),
            sent_bytes: AtomicU64::new(0),
            received_bytes: AtomicU64::new(0),
        })
    }

    pub(crate) fn traffic(&self) -> Traffic {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Traffic {
            requests: get(&self.requests),
            sent_bytes: get(&self.sent_bytes),
            received_bytes: get(&self.received_bytes),
        }
    }

    fn count(&self, sent: usize) {
        self.requests.fetch_add(1, Ordering::Relaxed);
        self.sent_bytes.fetch_add(sent as u64, Ordering::Relaxed);
    }

    fn received(&self, bytes: usize) {
        self.received_bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    fn path(&self, name: &str) -> Path {
        let parts = self.root.parts().map(|part| part.as_ref().to_owned());
        parts.chain(name.split('/').map(str::to_owned)).collect()
    }

    /// Returns the bytes of an object, or `None` if it does not exist.
    pub(crate) async fn get(&self, name: &str) -> Result<Option<Bytes>, RemoteError> {
        self.count(0);
        let Some(size) = self.readable_bytes(name).await? else {
            return Ok(None);
        };
        let most = names::most_bytes(name);
        if size > most {
            return Err(self.damaged(name, &format!("it has {size} bytes, above the limit of {most}")));
        }
        let path = self.path(name);
        let read = async {
            let found = self.objects.get(&path).await?;
            if self.folder.is_some() {
                found.bytes().await
            } else {
                collected(found, most).await.map(Bytes::from)
            }
        };
        let bytes = self.there("read", name, self.within(size, read).await)?;
        self.received(bytes.as_ref().map_or(0, Bytes::len));
        Ok(bytes)
    }

    /// Returns some ranges of an object, fetched together where they are close to each other, or `None` if it does
    /// not exist.
    pub(crate) async fn get_ranges(
        &self,
        name: &str,
        ranges: &[Range<u64>],
    ) -> Result<Option<Vec<Bytes>>, RemoteError> {
        self.count(0);
        let Some(size) = self.readable_bytes(name).await? else {
            return Ok(None);
        };
        if self.folder.is_some() && ranges.iter().any(|range| range.end > size) {
            return Err(self.damaged(name, "it ends before the bytes that its index names"));
        }
        let path = self.path(name);
        let read = async {
            if self.folder.is_some() {
                return self.objects.get_ranges(&path, ranges).await;
            }
            let get = |range| self.get_range(&path, range);
            coalesce_ranges(ranges, get, OBJECT_STORE_COALESCE_DEFAULT).await
        };
        let parts = self.there("read", name, self.within(size, read).await)?;
        self.received(parts.iter().flatten().map(Bytes::len).sum());
        Ok(parts)
    }

    /// Returns a range of an object on a server. Where the object is too short, zeros take the place of what is missing: their digest
    /// is another.
    async fn get_range(&self, path: &Path, range: Range<u64>) -> Result<Bytes, Error> {
        let length = range.end - range.start;
        let options = GetOptions {
            range: Some(GetRange::Bounded(range)),
            ..GetOptions::default()
        };
        let mut bytes = collected(self.objects.get_opts(path, options).await?, length).await?;
        bytes.resize(length as usize, 0);
        Ok(bytes.into())
    }

    /// Returns length and time of an object, or `None` if it does not exist.
    pub(crate) async fn find(&self, name: &str) -> Result<Option<StoredObject>, RemoteError> {
        self.count(0);
        // To look at a file is to open it.
        if self.readable_bytes(name).await?.is_none() {
            return Ok(None);
        }
        let found = self.within(0, self.objects.head(&self.path(name))).await;
        let listed = |meta: ObjectMeta| StoredObject {
            name: name.to_owned(),
            bytes: meta.size,
            modified: meta.last_modified.into(),
        };
        Ok(self.there("find", name, found)?.map(listed))
    }

    /// Writes an object and replaces an existing one.
    pub(crate) async fn put(&self, name: &str, bytes: Bytes) -> Result<(), RemoteError> {
        self.count(bytes.len());
        let (path, size) = (self.path(name), bytes.len() as u64);
        let written = self.objects.put(&path, PutPayload::from(bytes));
        self.within(size, written)
            .await
            .map(drop)
            .map_err(|error| self.error("write", name, &error))
    }

    /// Writes an object if there is none of this name, and returns whether there was none.
    pub(crate) async fn put_new(&self, name: &str, bytes: Bytes) -> Result<bool, RemoteError> {
        self.count(bytes.len());
        let options = PutOptions::from(PutMode::Create);
        let (path, size) = (self.path(name), bytes.len() as u64);
        let written = self.objects.put_opts(&path, PutPayload::from(bytes), options);
        match self.within(size, written).await {
            Ok(_) => Ok(true),
            Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => Ok(false),
            Err(error) => Err(self.error("write", name, &error)),
        }
    }

    /// Writes a pack, then its index, and returns its name.
    pub(crate) async fn put_pack(&self, pack: Pack) -> Result<Digest, RemoteError> {
        self.put(&names::pack(&pack.id), pack.bytes).await?;
        self.put(&names::index(&pack.id), pack.index).await?;
        Ok(pack.id)
    }

    /// Removes an object. A missing object is not an error.
    pub(crate) async fn remove(&self, name: &str) -> Result<(), RemoteError> {
        self.count(0);
        let removed = self.within(0, self.objects.delete(&self.path(name))).await;
        self.there("remove", name, removed).map(drop)
    }

    /// Returns the objects in a folder and below it, 1,000 a request.
    pub(crate) async fn list(&self, folder: &str) -> Result<Vec<StoredObject>, RemoteError> {
        let path = self.path(folder);
        let mut found = self.objects.list(Some(&path));
        let mut listed = Vec::new();
        while let Some(Some(meta)) = self.there("list", folder, self.within(0, found.try_next()).await)? {
            listed.push(meta);
        }
        self.requests
            .fetch_add(listed.len() as u64 / 1_000 + 1, Ordering::Relaxed);
        let depth = self.root.parts().count();
        Ok(listed
            .into_iter()
            .map(|meta| {
                let parts: Vec<String> = meta
                    .location
                    .parts()
                    .skip(depth)
                    .map(|part| part.as_ref().to_owned())
                    .collect();
                StoredObject {
                    name: parts.join("/"),
                    bytes: meta.size,
                    modified: meta.last_modified.into(),
                }
            })
            .collect())
    }

    /// Waits for the answer to a request that moves at most `bytes` bytes. A folder gets as long as a working file system may take.
    /// Servers have limits of their own.
    async fn within<T>(
        &self,
        bytes: u64,
        request: impl Future<Output = Result<T, Error>>,
    ) -> Result<T, Error> {
        if self.folder.is_none() {
            return request.await;
        }
        let patience = folder_patience(bytes);
        let silent = |_| Error::Generic {
            store: "folder",
            source: format!("no answer within {} s", patience.as_secs()).into(),
        };
        timeout(patience, request).await.map_err(silent)?
    }

    /// Returns the size of an object that may be read, or `None` if it does not exist. For a server the size is always 0. In a folder
    /// the object must be a regular file: a pipe would never end, and a link may lead anywhere.
    async fn readable_bytes(&self, name: &str) -> Result<Option<u64>, RemoteError> {
        let Some(folder) = self.folder.clone() else {
            return Ok(Some(0));
        };
        // As it is in the file system: some characters are encoded.
        let path = self.path(name).as_ref().to_owned();
        let opened = unblocked(FOLDER_PATIENCE, move || {
            let file = file::open(&file::below(&folder, &path)?, Links::Refused)?;
            Ok::<u64, std::io::Error>(file.metadata()?.len())
        });
        let (place, doing, object) = (self.place.clone(), "read", name.to_owned());
        match opened.await.flatten() {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) => match error.kind() {
                ErrorKind::NotFound => Ok(None),
                ErrorKind::InvalidInput => Err(self.damaged(name, &error.to_string())),
                ErrorKind::PermissionDenied => Err(RemoteError::Denied { place, doing, object }),
                _ => Err(RemoteError::Failed {
                    place,
                    doing,
                    object,
                    cause: error.to_string(),
                }),
            },
        }
    }

    /// Returns the answer, or `None` if the object does not exist.
    fn there<T>(
        &self,
        doing: &'static str,
        name: &str,
        answer: Result<T, Error>,
    ) -> Result<Option<T>, RemoteError> {
        match answer {
            Ok(found) => Ok(Some(found)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.error(doing, name, &error)),
        }
    }

    fn error(&self, doing: &'static str, name: &str, error: &Error) -> RemoteError {
        let (place, object) = (self.place.clone(), name.to_owned());
        match error {
            Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
                RemoteError::Denied { place, doing, object }
            }
            Error::NotFound { .. } => RemoteError::Failed {
                place,
                doing,
                object,
                cause: "the bucket is not there".to_owned(),
            },
            error => RemoteError::Failed {
                place,
                doing,
                object,
                cause: cause_of(error),
            },
        }
    }

    pub(crate) fn damaged(&self, name: &str, what: &str) -> RemoteError {
        RemoteError::Damaged {
            place: self.place.clone(),
            object: name.to_owned(),
            what: what.to_owned(),
        }
    }
}

/// Reads an answer to its end. Memory is taken for bytes that have come and never for those that are announced.
async fn collected(found: GetResult, most: u64) -> Result<Vec<u8>, Error> {
    let mut stream = found.into_stream();
    let mut bytes = Vec::new();
    while let Some(chunk) = stream.try_next().await? {
        if (bytes.len() + chunk.len()) as u64 > most {
            return Err(Error::Generic {
                store: "S3",
                source: format!("the server sends more than {most} bytes").into(),
            });
        }
        bytes.extend_from_slice(&chunk);
    }
    Ok(bytes)
}
