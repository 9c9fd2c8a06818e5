//! What an archive may reach: the machine it runs on, or servers.
//!
//! A [`NetworkPermit`] is the only way to a [`crate::net::Client`], and a [`RemoteContext`] is the only way to a
//! permit. The table of kinds gives a context only to kinds that are declared [`Remote`], and never under
//! `--offline`.

use std::path::{Path, PathBuf};

use marf_stage::{Access, ArchiveContext, ParamError, StageError};

/// The archive lies on this machine: it is opened without access to the network.
pub(crate) enum Local {}

/// The archive is on servers. It obeys `--locked` and `--offline`, and marf.lock pins the files it served.
pub(crate) enum Remote {}

/// Where the files of a kind of archive lie: [`Local`] or [`Remote`].
pub(crate) trait Location: sealed::Sealed {}

impl Location for Local {}
impl Location for Remote {}

pub(super) mod sealed {
    use super::{ArchiveContext, Local, LocalContext, ParamError, Remote, RemoteContext};

    /// The part of [`super::Location`] that kinds can neither implement nor call.
    pub trait Sealed {
        /// Context that a kind is opened with, in addition to its parameters.
        type Context;
        /// Whether connections are opened.
        const REMOTE: bool;
        /// Takes what such a kind may know of its surroundings.
        fn context(context: ArchiveContext) -> Result<Self::Context, ParamError>;
    }

    impl Sealed for Local {
        type Context = LocalContext;
        const REMOTE: bool = false;

        fn context(context: ArchiveContext) -> Result<LocalContext, ParamError> {
            Ok(LocalContext {
                folder: context.folder,
                rehash: context.rehash,
            })
        }
    }

    impl Sealed for Remote {
        type Context = RemoteContext;
        const REMOTE: bool = true;

        fn context(context: ArchiveContext) -> Result<RemoteContext, ParamError> {
            let lock = context.lock.ok_or_else(|| {
                ParamError::new(
                    "kind",
                    "an archive on a server can only be read as part of a pipeline",
                )
            })?;
            Ok(RemoteContext {
                name: context.name,
                lock,
                access: context.access,
            })
        }
    }
}

/// What a local archive knows of its surroundings.
pub(crate) struct LocalContext {
    folder: PathBuf,
    rehash: bool,
}

impl LocalContext {
    /// Resolves a path of the archive's table. A relative path starts at the folder of pipeline.toml.
    pub fn path(&self, path: &Path) -> PathBuf {
        self.folder.join(path)
    }

    /// Whether files are read again even if nothing indicates a change.
    pub fn rehash(&self) -> bool {
        self.rehash
    }
}

/// What a remote archive knows of its surroundings.
pub(crate) struct RemoteContext {
    name: String,
    lock: PathBuf,
    access: Access,
}

impl RemoteContext {
    /// Returns the name of the `[archive.*]` table.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the path of the lock.
    pub fn lock(&self) -> &Path {
        &self.lock
    }

    /// Returns the permitted use of the network.
    pub fn access(&self) -> Access {
        self.access
    }

    /// Returns the permit to open connections.
    ///
    /// # Errors
    /// There is none under `--offline`.
    pub fn permit(&self) -> Result<NetworkPermit, StageError> {
        match self.access {
            Access::Online | Access::Locked => Ok(NetworkPermit(())),
            Access::Offline => Err(StageError::new(format!(
                "archive `{}` may open no connection under --offline",
                self.name
            ))
            .hint("run once without --offline")),
        }
    }
}

/// The permit to open connections. Only [`RemoteContext::permit`] makes one.
#[derive(Debug)]
pub(crate) struct NetworkPermit(());

#[cfg(test)]
impl NetworkPermit {
    /// A permit for tests of the client.
    pub fn for_tests() -> Self {
        Self(())
    }
}

#[cfg(test)]
mod tests {
    use super::sealed::Sealed as _;
    use super::*;

    fn context(access: Access) -> ArchiveContext {
        ArchiveContext {
            name: "a".to_owned(),
            folder: PathBuf::from("there"),
            lock: Some(PathBuf::from("there/marf.lock")),
            access,
            ..ArchiveContext::default()
        }
    }

    #[test]
    fn a_permit_is_given_online_and_locked_and_never_offline() {
        let permit = |access| Remote::context(context(access)).unwrap().permit();
        assert!(permit(Access::Online).is_ok() && permit(Access::Locked).is_ok());
        let refused = permit(Access::Offline).unwrap_err().to_string();
        assert!(
            refused.contains("`a`") && refused.contains("--offline"),
            "{refused}"
        );
    }

    /// The fields are matched in full: a local context that held a permit, or a way to one, would not compile.
    #[test]
    fn a_local_archive_gets_a_folder_and_no_way_to_the_network() {
        let LocalContext { folder, rehash } = Local::context(context(Access::Online)).unwrap();
        assert!(!rehash);
        assert_eq!(folder, Path::new("there"));
    }

    #[test]
    fn without_a_pipeline_a_remote_archive_is_refused() {
        let refused = Remote::context(ArchiveContext::default()).err().unwrap();
        assert!(refused.message.contains("pipeline"), "{refused}");
    }
}
