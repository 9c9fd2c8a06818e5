use std::{io, path::PathBuf};

use crate::Digest;

/// Why the store did not give or take something.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Nobody put it, or it was set aside before.
    #[error("blob {digest} is not in the store")]
    Missing {
        /// The blob asked for.
        digest: Digest,
    },
    /// Its bytes are not the ones it is named by; it has just been set aside.
    #[error("blob {digest} was damaged; it is set aside as `{}`", path.display())]
    Damaged {
        /// The blob asked for.
        digest: Digest,
        /// Where the damaged bytes are now.
        path: PathBuf,
    },
    /// A file of the store could not be read or written (a full disk, a read-only store).
    #[error("cannot {doing} `{}`: {source}", path.display())]
    Io {
        /// What was tried, as an infinitive (`write`).
        doing: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// Another program has held the index for longer than a commit may take.
    #[error("the index `{}` has been in use by another program for {waited_ms} ms", path.display())]
    Locked {
        /// The index file.
        path: PathBuf,
        /// How long we waited.
        waited_ms: u64,
    },
    /// The index cannot be used.
    #[error("the index `{}` cannot be used: {message}", path.display())]
    Index {
        /// The index file.
        path: PathBuf,
        /// What the database says.
        message: String,
    },
}

impl StoreError {
    pub(super) fn io(doing: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { doing, path, source }
    }

    /// Returns the blob that is missing or damaged, so that its producer can run again.
    pub fn lost(&self) -> Option<Digest> {
        match self {
            Self::Missing { digest } | Self::Damaged { digest, .. } => Some(*digest),
            _ => None,
        }
    }

    /// Returns what to do about it, if we know.
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
