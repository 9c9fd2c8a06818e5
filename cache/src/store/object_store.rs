//! Committed blobs: loose files under `cas/`, packs under `packs/`, damaged ones in quarantine under `bad/`.

use std::{
    collections::{BTreeSet, HashMap},
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use parking_lot::Mutex;

use super::{
    error::StoreError,
    files::{self, Published},
    pack,
    staging::StagingDir,
    write_batch::{LargeBlob, WriteBatch},
};
use crate::Digest;

/// All committed blobs of a store, also those that other processes add.
pub(super) struct ObjectStore {
    root: PathBuf,
    packs: Mutex<PackIndex>,
}

/// The packs read so far, and where their blobs are.
#[derive(Default)]
struct PackIndex {
    loaded: BTreeSet<String>,
    locations: HashMap<Digest, PackLocation>,
}

#[derive(Clone)]
struct PackLocation {
    pack: Arc<str>,
    offset: u64,
    len: u32,
}

/// A pack that is still a temporary file.
struct NewPack {
    name: String,
    file: PathBuf,
    entries: Vec<pack::Entry>,
}

/// Numbers of blobs and bytes, by form.
pub(super) struct Count {
    pub(super) loose: u64,
    pub(super) loose_bytes: u64,
    pub(super) packs: u64,
    pub(super) packed: u64,
    pub(super) packed_bytes: u64,
    pub(super) quarantined: u64,
}

impl ObjectStore {
    /// Returns the objects below the folder of a store; reads nothing.
    pub(super) fn new(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
            packs: Mutex::default(),
        }
    }

    fn packs_dir(&self) -> PathBuf {
        self.root.join("packs")
    }

    /// Returns the path of a blob that is a file of its own.
    pub(super) fn loose_path(&self, digest: &Digest) -> PathBuf {
        let hex = digest.to_string();
        self.root.join("cas").join(&hex[..2]).join(&hex[2..])
    }

    fn quarantine_dir(&self) -> PathBuf {
        self.root.join("bad")
    }

    fn location(&self, digest: &Digest) -> Option<PackLocation> {
        self.packs.lock().locations.get(digest).cloned()
    }

    /// Tells whether a blob is stored, without a look for packs that other processes added.
    pub(super) fn knows(&self, digest: &Digest) -> bool {
        self.location(digest).is_some() || self.loose_path(digest).exists()
    }

    /// Returns a blob's length in bytes.
    pub(super) fn size_of(&self, digest: &Digest) -> Option<u64> {
        let packed = || self.location(digest).map(|location| u64::from(location.len));
        packed()
            .or_else(|| Some(fs::metadata(self.loose_path(digest)).ok()?.len()))
            .or_else(|| self.refresh().ok().and_then(|()| packed()))
    }

    /// Reads and verifies a blob; a damaged one is quarantined.
    pub(super) fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StoreError> {
        if let Some(location) = self.location(digest) {
            return self.get_packed(digest, &location);
        }
        let path = self.loose_path(digest);
        match fs::read(&path) {
            Ok(bytes) if Digest::of(&bytes) == *digest => return Ok(Arc::from(bytes)),
            Ok(_) => return Err(self.quarantine_loose(digest, &path)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(StoreError::io("read", path)(error)),
        }
        self.refresh()?;
        match self.location(digest) {
            Some(location) => self.get_packed(digest, &location),
            None => Err(StoreError::Missing { digest: *digest }),
        }
    }

    fn get_packed(&self, digest: &Digest, location: &PackLocation) -> Result<Arc<[u8]>, StoreError> {
        let path = self.packs_dir().join(format!("{}.pack", location.pack));
        let bytes = match pack::read(&path, location.offset, location.len) {
            Err(error)
                if !matches!(
                    error.kind(),
                    io::ErrorKind::NotFound | io::ErrorKind::UnexpectedEof
                ) =>
            {
                return Err(StoreError::io("read", path)(error));
            }
            // A pack that is absent or truncated is as damaged as one with a flipped bit.
            read => read.unwrap_or_default(),
        };
        if Digest::of(&bytes) == *digest {
            return Ok(Arc::from(bytes));
        }
        Err(self.quarantine_packed(digest, location, &bytes))
    }

    /// Moves a damaged loose blob to the quarantine.
    fn quarantine_loose(&self, digest: &Digest, path: &Path) -> StoreError {
        let to = self.quarantine_dir().join(digest.to_string());
        let moved = files::create_dir(&self.quarantine_dir())
            .and_then(|()| fs::rename(path, &to).map_err(StoreError::io("quarantine", path)));
        damaged(digest, to, moved)
    }

    /// Copies a damaged blob of a pack to the quarantine. The pack itself never changes: the name of the copy
    /// holds that of the pack, and marks this blob of it as damaged.
    fn quarantine_packed(&self, digest: &Digest, location: &PackLocation, bytes: &[u8]) -> StoreError {
        let to = self.quarantine_dir().join(format!("{digest}.{}", location.pack));
        let written = files::create_dir(&self.quarantine_dir()).and_then(|()| match to.exists() {
            true => Ok(()),
            false => files::write_new(&to, &[bytes]),
        });
        self.packs.lock().locations.remove(digest);
        damaged(digest, to, written)
    }

    /// Writes the blobs of a batch: first their bytes, then their names, then the folders.
    pub(super) fn write(
        &self,
        batch: &WriteBatch,
        staging: impl FnOnce() -> Result<Arc<StagingDir>, StoreError>,
    ) -> Result<(), StoreError> {
        let mut unsynced: Vec<PathBuf> = batch.large.values().map(|large| large.path.clone()).collect();
        unsynced.retain(|path| path.exists()); // published by an attempt that failed later
        let mut folders = BTreeSet::new();
        let pack = match batch.small.is_empty() {
            true => None,
            false => Some(NewPack::write(batch, &*staging()?)?),
        };
        if let Some(pack) = &pack {
            unsynced.extend([pack.file.clone(), pack.file.with_extension("idx")]);
        }
        files::sync(&unsynced)?;
        for (digest, large) in &batch.large {
            self.publish_large(digest, large, &mut folders)?;
        }
        if let Some(pack) = &pack {
            let to = self.packs_dir().join(&pack.name);
            files::publish(&pack.file, &to.with_extension("pack"))?;
            files::publish(&pack.file.with_extension("idx"), &to.with_extension("idx"))?;
            folders.insert(self.packs_dir());
        }
        files::sync(&folders.into_iter().collect::<Vec<_>>())?;
        if let Some(pack) = pack {
            self.packs.lock().add(&pack.name, &pack.entries, &BTreeSet::new());
        }
        Ok(())
    }

    fn publish_large(
        &self,
        digest: &Digest,
        large: &LargeBlob,
        folders: &mut BTreeSet<PathBuf>,
    ) -> Result<(), StoreError> {
        let to = self.loose_path(digest);
        if to.exists() {
            let _ = fs::remove_file(&large.path);
            return Ok(());
        }
        let Some(folder) = to.parent() else { return Ok(()) };
        if !folder.is_dir() {
            files::create_dir(folder)?;
            folders.insert(self.root.join("cas"));
        }
        if files::publish(&large.path, &to)? == Published::New {
            folders.insert(folder.to_owned());
        }
        Ok(())
    }

    /// Reads the indices of packs that were added since the last call.
    pub(super) fn refresh(&self) -> Result<(), StoreError> {
        let listed = files::names(&self.packs_dir())?;
        let mut packs = self.packs.lock();
        let new: Vec<&str> = listed
            .iter()
            .filter_map(|name| name.strip_suffix(".pack"))
            .filter(|name| !packs.loaded.contains(*name))
            .collect();
        if new.is_empty() {
            return Ok(());
        }
        let quarantined: BTreeSet<String> = files::names(&self.quarantine_dir())?.into_iter().collect();
        for name in new {
            let entries = pack::load(&self.packs_dir().join(format!("{name}.pack")))?;
            packs.add(name, &entries, &quarantined);
        }
        Ok(())
    }

    /// Counts blobs and bytes.
    pub(super) fn count(&self) -> Result<Count, StoreError> {
        self.refresh()?;
        let (mut loose, mut loose_bytes) = (0, 0);
        for folder in files::names(&self.root.join("cas"))? {
            let dir = self.root.join("cas").join(folder);
            for name in files::names(&dir)? {
                loose += 1;
                loose_bytes += fs::metadata(dir.join(name)).map_or(0, |meta| meta.len());
            }
        }
        let packs = self.packs.lock();
        let packed_bytes = packs.locations.values();
        Ok(Count {
            loose,
            loose_bytes,
            packs: packs.loaded.len() as u64,
            packed: packs.locations.len() as u64,
            packed_bytes: packed_bytes.map(|location| u64::from(location.len)).sum(),
            quarantined: files::names(&self.quarantine_dir())?.len() as u64,
        })
    }
}

/// Returns the error that tells of a damaged blob, or why it could not be quarantined.
fn damaged(digest: &Digest, path: PathBuf, quarantined: Result<(), StoreError>) -> StoreError {
    match quarantined {
        Ok(()) => StoreError::Damaged {
            digest: *digest,
            path,
        },
        Err(error) => error,
    }
}

impl NewPack {
    /// Writes the small blobs of a batch and their index as temporary files.
    fn write(batch: &WriteBatch, staging: &StagingDir) -> Result<Self, StoreError> {
        let name = staging.next_name();
        let file = staging.path(&format!("{name}.pack"));
        let entries = pack::write(&file, &file.with_extension("idx"), &batch.small)?;
        Ok(Self { name, file, entries })
    }
}

impl PackIndex {
    /// Adds the entries of a pack, except those that are quarantined.
    fn add(&mut self, name: &str, entries: &[pack::Entry], quarantined: &BTreeSet<String>) {
        let pack: Arc<str> = Arc::from(name);
        for entry in entries {
            if !quarantined.is_empty() && quarantined.contains(&format!("{}.{name}", entry.digest)) {
                continue;
            }
            let location = PackLocation {
                pack: Arc::clone(&pack),
                offset: entry.offset,
                len: entry.len,
            };
            self.locations.entry(entry.digest).or_insert(location);
        }
        self.loaded.insert(name.to_owned());
    }
}
