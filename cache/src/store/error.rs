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
    /// The bytes do not have their digest. The blob is now in quarantine.
    #[error("blob {digest} was damaged and is in quarantine as `{}`", path.display())]
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
    /// Another program holds a lock of the store.
    #[error("`{}` has been in use by another program for {waited_ms} ms", path.display())]
    Locked {
        /// The file that is locked.
        path: PathBuf,
        /// The time waited.
        waited_ms: u64,
    },
    /// The root of a run cannot be read. The file is now in quarantine.
    #[error("run {number} was damaged and is in quarantine as `{}`", path.display())]
    DamagedRun {
        /// Number of the run.
        number: u64,
        /// The file in quarantine.
        path: PathBuf,
    },
    /// There is no run of this number.
    #[error("there is no run {number} in the store")]
    NoRun {
        /// The number asked for.
        number: u64,
    },
    /// The file is longer than the caller takes.
    #[error("`{}` has {bytes} bytes, above the limit of {max_bytes}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
        /// The most bytes taken.
        max_bytes: u64,
    },
    /// A blob that the store lacks cannot be fetched.
    #[error("blob {digest} is not in the store and cannot be fetched: {message}")]
    Upstream {
        /// The blob asked for.
        digest: Digest,
        /// Why not.
        message: String,
    },
    /// The caller wants to stop.
    #[error("stopped")]
    Stopped,
    /// A later program wrote the store.
    #[error("the store `{}` has format {found}, but this program reads format {known}", path.display())]
    Newer {
        /// The folder of the store.
        path: PathBuf,
        /// Its format.
        found: u32,
        /// The format of this program.
        known: u32,
    },
}

impl StoreError {
    pub(super) fn io(doing: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { doing, path, source }
    }

    /// Returns whether the store may not be written.
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
                Some("free space on this disk and run again. Finished results are kept".to_owned())
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
            Self::Newer { .. } => {
                Some("use the program that wrote it, or another folder with `--store`".to_owned())
            }
            _ => None,
        }
    }
}
