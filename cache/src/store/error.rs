use std::{io, path::PathBuf};

use crate::Digest;

/// Why the store could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The blob was never stored, or is in quarantine.
    #[error("blob {digest} is not in the store")]
    Missing {
        /// The blob asked for.
        digest: Digest,
    },
    /// The bytes do not have their digest; the blob has just been quarantined.
    #[error("blob {digest} was damaged; it is in quarantine as `{}`", path.display())]
    Damaged {
        /// The blob asked for.
        digest: Digest,
        /// The file in quarantine.
        path: PathBuf,
    },
    /// A file of the store could not be read or written (a full disk, a read-only store).
    #[error("cannot {doing} `{}`: {source}", path.display())]
    Io {
        /// The operation, as an infinitive (`write`).
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// Another program has held the index for longer than a commit may take.
    #[error("the index `{}` has been in use by another program for {waited_ms} ms", path.display())]
    Locked {
        /// The index file.
        path: PathBuf,
        /// The time waited.
        waited_ms: u64,
    },
    /// The index cannot be used.
    #[error("the index `{}` cannot be used: {message}", path.display())]
    Index {
        /// The index file.
        path: PathBuf,
        /// The error of the database.
        message: String,
    },
}

impl StoreError {
    pub(super) fn io(doing: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { doing, path, source }
    }

    /// Tells whether the store may not be written.
    pub fn is_read_only(&self) -> bool {
        use io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
        matches!(self, Self::Io { source, .. } if matches!(source.kind(), ReadOnlyFilesystem | PermissionDenied))
    }

    /// Returns the digest of the blob that is missing or damaged.
    pub fn lost(&self) -> Option<Digest> {
        match self {
            Self::Missing { digest } | Self::Damaged { digest, .. } => Some(*digest),
            _ => None,
        }
    }

    /// Returns what the user can do about it, if anything.
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Io { source, .. } if source.kind() == io::ErrorKind::StorageFull => {
                Some("free space on this disk and run again; what was finished stays".to_owned())
            }
            Self::Io { source, .. }
                if matches!(
                    source.kind(),
                    io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied
                ) =>
            {
                Some("choose a store that can be written with `--store`".to_owned())
            }
            Self::Locked { .. } => Some("wait for the other program, or stop it".to_owned()),
            Self::Index { path, .. } => Some(format!(
                "move `{}` away and run again: blobs stay, records are made anew",
                path.display()
            )),
            _ => None,
        }
    }
}
