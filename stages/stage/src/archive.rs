use std::collections::BTreeMap;
use std::path::PathBuf;

use marf_cache::Digest;

use crate::{Shard, Table};

/// Name of the folder that pins what archives on servers gave; it lies beside pipeline.toml.
pub const LOCK_FILE: &str = "marf.lock";

/// What an archive may ask of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// List what the server has, and fetch what is new.
    Online,
    /// Take exactly what the lock file names; fetch what of it is not in the store.
    Locked,
    /// As `Locked`, and open no connection.
    Offline,
}

/// An archive as an earlier run met it: its files are read from the store, wherever they lay then.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedArchive {
    /// The shards, sorted, each with the digest of the list of its files ([`crate::Origin`]).
    pub shards: Vec<(Shard, Digest)>,
    /// Companion files by name.
    pub companions: BTreeMap<String, Digest>,
}

/// What an archive is told beside the keys of its `[archive.*]` table; no part of it is in a key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArchiveContext {
    /// Name of the `[archive.*]` table.
    pub name: String,
    /// Folder from which relative paths of the table are meant: that of pipeline.toml.
    pub folder: PathBuf,
    /// Path of the lock ([`LOCK_FILE`]); `None` where there is none.
    pub lock: Option<PathBuf>,
    /// What may be asked of the network.
    pub access: Access,
    /// Whether files on disk are read again though nothing says that they changed.
    pub rehash: bool,
    /// Tables of measures that stages of the pipeline read, to be filled of every photo that is fetched. They change no row.
    pub measures: Vec<Table>,
    /// What an earlier run met, to be read again in place of the archive itself, which is then not looked at.
    pub recorded: Option<RecordedArchive>,
}

/// The context of an archive outside a pipeline: it has no lock file and may open no connection.
impl Default for ArchiveContext {
    fn default() -> Self {
        Self {
            name: String::new(),
            folder: PathBuf::new(),
            lock: None,
            access: Access::Offline,
            rehash: false,
            measures: Vec::new(),
            recorded: None,
        }
    }
}
