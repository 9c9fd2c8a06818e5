//! What every archive gives: files by shard, each with its kind and digest.

pub(crate) mod access;
pub(crate) mod check;
mod file_kind;
pub(crate) mod kind;

use std::io::ErrorKind;
use std::path::PathBuf;
use std::sync::Arc;

use marf_cache::file::{Links, read_within};
use marf_cache::{Digest, Sha256};
use marf_pds::{Label, ProductName, feed, pds4, raw};
use marf_stage::{Cancel, Ctx, Files, Keep, Listing, Origin, OriginKind, StageError};
use serde::{Deserialize, Serialize};

pub(crate) use file_kind::{extension, folder, is_system_name, kind, kind_and_reason, stem};

/// An archive, ready to be read.
pub(crate) trait ArchiveFiles: Send + Sync {
    /// Lists shards with fingerprints over all their files, and stores companions.
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError>;
    /// Returns the names and digests of the files of one listed shard, where they are known without a download.
    fn digests(&self, _ctx: &Ctx<'_>, _shard: u32) -> Result<Option<Files>, StageError> {
        Ok(None)
    }
    /// Returns the files of one listed shard. Files on servers are downloaded.
    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<ShardFiles, StageError>;
    /// Asks a server for one thing of each kind that is read. Files on this machine have no checks.
    fn check(&self, _cancel: &Cancel) -> Result<Vec<check::Check>, StageError> {
        Ok(Vec::new())
    }
}

/// The files of a shard.
#[derive(Debug, Default)]
pub(crate) struct ShardFiles {
    /// The files.
    pub files: Vec<ArchiveFile>,
    /// The fingerprint that the bytes have, where the listing could not know them.
    pub fingerprint: Option<Digest>,
    /// What people should know, one sentence each.
    pub warnings: Vec<String>,
}

/// A file of an archive.
#[derive(Debug, Clone)]
pub(crate) struct ArchiveFile {
    /// Name in the archive, relative, with `/`.
    pub name: String,
    /// Its kind.
    pub kind: OriginKind,
    /// Why it is not taken.
    pub reason: Option<String>,
    /// Digest of its bytes, or of the reason why it cannot be read.
    pub digest: Digest,
    bytes: Bytes,
    /// Where it came from. `None` for a local file.
    fetched: Option<FetchedFrom>,
}

/// Where a file came from.
#[derive(Debug, Clone)]
pub(crate) struct FetchedFrom {
    /// The address that served it. `None` if it came with the listing.
    pub url: Option<String>,
    /// The time, as `YYYY-MM-DDTHH:MM:SSZ`.
    pub time: String,
}

/// A file whose bytes were read, and are in the store.
#[derive(Debug, Clone)]
pub(crate) struct ReadFile {
    /// Its name in the archive.
    pub name: String,
    bytes: u64,
    sha256: Sha256,
}

impl ReadFile {
    /// Notes that a file was read.
    pub fn new(file: &ArchiveFile, bytes: &[u8]) -> Self {
        Self {
            name: file.name.clone(),
            bytes: bytes.len() as u64,
            sha256: Sha256::from_content(bytes),
        }
    }
}

/// A file on disk, and how it is read.
#[derive(Debug, Clone)]
pub(crate) struct LocalFile {
    /// Where it is.
    pub path: PathBuf,
    /// How the store keeps its bytes.
    pub keep: Keep,
    /// Largest file that is read, bytes.
    pub limit_bytes: u64,
}

#[derive(Debug, Clone)]
enum Bytes {
    Memory(Arc<[u8]>),
    Local(LocalFile),
    /// In the store, under the file's digest.
    Stored,
}

/// Why bytes were not read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum ReadError {
    /// The operating system refused.
    #[error("cannot be read: {0}")]
    Io(std::io::ErrorKind),
    /// Too large.
    #[error(
        "more than {} MB: raise `max_file_mb` of the archive in pipeline.toml",
        .limit_bytes / 1_000_000
    )]
    TooLarge {
        /// Largest file that is read, bytes.
        limit_bytes: u64,
    },
}

impl ArchiveFile {
    /// Returns a file whose bytes are in memory, for archives that make their files.
    pub fn in_memory(name: String, bytes: Vec<u8>) -> Self {
        let (kind, reason) = kind_and_reason(&name, &bytes);
        Self {
            digest: Digest::from_content(&bytes),
            bytes: Bytes::Memory(bytes.into()),
            fetched: None,
            name,
            kind,
            reason,
        }
    }

    /// Returns a file on disk whose kind, digest and sol are known.
    pub fn on_disk(name: String, file: LocalFile, known: Known) -> Self {
        Self {
            name,
            kind: known.kind,
            reason: known.reason,
            digest: known.digest,
            bytes: Bytes::Local(file),
            fetched: None,
        }
    }

    /// Returns a file whose bytes are in the store. Its kind follows from its name alone.
    pub fn stored(name: String, digest: Digest, fetched: FetchedFrom) -> Self {
        let (kind, reason) = kind_and_reason(&name, &[]);
        Self {
            kind,
            reason,
            digest,
            bytes: Bytes::Stored,
            fetched: Some(fetched),
            name,
        }
    }

    /// Returns a file as an earlier run recorded it. Its bytes are in the store if that run read it.
    pub fn recorded(origin: Origin) -> Self {
        Self {
            kind: origin.kind,
            reason: origin.reason,
            digest: origin.blake3,
            bytes: Bytes::Stored,
            fetched: origin.fetched.map(|time| FetchedFrom {
                url: origin.url,
                time,
            }),
            name: origin.file,
        }
    }

    /// Returns a file that an archive lists and that is not taken.
    pub fn left_out(name: String, reason: String) -> Self {
        Self {
            digest: Digest::from_content(reason.as_bytes()),
            bytes: Bytes::Memory(Arc::default()),
            fetched: None,
            kind: OriginKind::Other,
            reason: Some(reason),
            name,
        }
    }

    /// Stores the bytes under [`ArchiveFile::digest`] and returns them.
    ///
    /// # Errors
    /// The store, or a file that has changed since it was listed.
    pub fn keep(&self, ctx: &Ctx<'_>) -> Result<Arc<[u8]>, StageError> {
        match &self.bytes {
            Bytes::Memory(bytes) => {
                ctx.put(bytes)?;
                Ok(Arc::clone(bytes))
            }
            Bytes::Stored => {
                let bytes = ctx.get(&self.digest)?;
                // So that the result needs it, also where no row names it.
                ctx.put(&bytes)?;
                Ok(bytes)
            }
            Bytes::Local(file) => match ctx.blobs.put_file(&file.path, file.limit_bytes, file.keep) {
                Ok((digest, bytes)) if digest == self.digest => Ok(bytes),
                Ok(_) => Err(self.changed(OTHER_BYTES)),
                // What cannot be read is the file's fault, all else the store's.
                Err(error) => Err(match read_path(&file.path, file.limit_bytes) {
                    Err(unreadable) => self.changed(&unreadable.to_string()),
                    Ok(_) => error.into(),
                }),
            },
        }
    }

    /// Returns the bytes, checked to be those that were listed.
    ///
    /// # Errors
    /// A file that has changed since: its shard's fingerprint would name other bytes.
    pub fn read(&self, ctx: &Ctx<'_>) -> Result<Vec<u8>, StageError> {
        let bytes = match &self.bytes {
            Bytes::Memory(bytes) => bytes.to_vec(),
            Bytes::Stored => return Ok(ctx.get(&self.digest)?.to_vec()),
            Bytes::Local(file) => {
                let read = read_path(&file.path, file.limit_bytes);
                read.map_err(|error| self.changed(&error.to_string()))?
            }
        };
        if Digest::from_content(&bytes) == self.digest {
            Ok(bytes)
        } else {
            Err(self.changed(OTHER_BYTES))
        }
    }

    /// Returns the origin of the file, stored next to the result. `read` is its content, if it was read.
    pub fn origin(&self, read: Option<&ReadFile>) -> Origin {
        let from = self.fetched.as_ref();
        Origin {
            file: self.name.clone(),
            kind: self.kind,
            blake3: self.digest,
            bytes: read.map(|read| read.bytes),
            sha256: read.map(|read| read.sha256),
            url: from.and_then(|from| from.url.clone()),
            fetched: from.map(|from| from.time.clone()),
            reason: self.reason.clone(),
        }
    }

    fn changed(&self, cause: &str) -> StageError {
        StageError::new(format!("`{}` changed while it was read", self.name))
            .cause(cause)
            .hint("run again when nothing writes into the archive")
    }
}

/// Why a file is not the listed one.
const OTHER_BYTES: &str = "its bytes differ from those that were listed";

/// Facts about a file from its name and its bytes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Known {
    /// Its kind.
    pub kind: OriginKind,
    /// Why it is not taken.
    pub reason: Option<String>,
    /// Digest of its bytes.
    pub digest: Digest,
    /// Sol, where the name or the file's own label has it.
    pub sol: Option<u32>,
}

impl Known {
    /// Reads a file on disk.
    ///
    /// # Errors
    /// Why it cannot be read.
    pub fn read(name: &str, path: &std::path::Path, limit_bytes: u64) -> Result<Self, ReadError> {
        let bytes = read_path(path, limit_bytes)?;
        let (kind, reason) = kind_and_reason(name, &bytes);
        Ok(Self {
            digest: Digest::from_content(&bytes),
            sol: own_sol(name, kind, &bytes),
            kind,
            reason,
        })
    }
}

/// Reads a label of any kind.
///
/// # Errors
/// The reason why the bytes are not a label of that kind.
pub(crate) fn read_label(kind: OriginKind, bytes: &[u8]) -> Result<Label, String> {
    match kind {
        OriginKind::Pds4 => pds4::read(bytes).map_err(|error| error.to_string()),
        OriginKind::Feed => feed::read(bytes).map_err(|error| error.to_string()),
        OriginKind::Odl | OriginKind::Raw => raw::head(bytes),
        other => Err(format!("{other:?} is not a label")),
    }
}

fn read_path(path: &std::path::Path, limit_bytes: u64) -> Result<Vec<u8>, ReadError> {
    read_within(path, limit_bytes, Links::Followed).map_err(|error| match error.kind() {
        ErrorKind::FileTooLarge => ReadError::TooLarge { limit_bytes },
        kind => ReadError::Io(kind),
    })
}

/// Returns the sol by the name, or by the label that the file is or begins with.
fn own_sol(name: &str, kind: OriginKind, bytes: &[u8]) -> Option<u32> {
    ProductName::read(stem(name))
        .and_then(|product| product.sol)
        .or_else(|| match kind {
            OriginKind::Pds4 | OriginKind::Feed | OriginKind::Odl | OriginKind::Raw => {
                read_label(kind, bytes).ok()?.sol
            }
            _ => None,
        })
}
