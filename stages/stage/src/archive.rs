use std::collections::BTreeMap;
use std::path::PathBuf;

use marf_cache::Digest;

use crate::{Shard, Table};

/// Name of the folder that pins the files of archives on servers. It is next to pipeline.toml.
pub const LOCK_FILE: &str = "marf.lock";

/// What an archive may ask of the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// List what the server has, and fetch what is new.
    Online,
    /// Take exactly the files that [`LOCK_FILE`] pins, and fetch those that are not in the store.
    Locked,
    /// As `Locked`, and open no connection.
    Offline,
}

/// An archive as recorded by an earlier run: its files are read from the store, regardless of their original
/// place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordedArchive {
    /// The shards, sorted, each with the digest of the list of its files ([`crate::Origin`]).
    pub shards: Vec<(Shard, Digest)>,
    /// Companion files by name.
    pub companions: BTreeMap<String, Digest>,
}

/// Context of an archive outside the keys of its `[archive.*]` table. No part of it is in a key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArchiveContext {
    /// Name of the `[archive.*]` table.
    pub name: String,
    /// Folder from which relative paths of the table are meant: that of pipeline.toml.
    pub folder: PathBuf,
    /// Path of the lock ([`LOCK_FILE`]), or `None` without a lock.
    pub lock: Option<PathBuf>,
    /// What may be asked of the network.
    pub access: Access,
    /// Whether files on disk are read again though nothing says that they changed.
    pub rehash: bool,
    /// Tables of measures that stages of the pipeline read, to be filled of every photo that is fetched. They change no row.
    pub measures: Vec<Table>,
    /// Recorded archive of an earlier run, which is read instead of the archive itself.
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
