//! Sealed blobs: loose files under `cas/`, packs under `packs/`, and what was found damaged under `bad/`.

use std::{
    collections::{BTreeSet, HashMap},
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use parking_lot::{Mutex, MutexGuard};

use super::{StoreError, files, pack};
use crate::Digest;

/// All sealed blobs of a store, also those that other processes add.
pub(super) struct Shelf {
    root: PathBuf,
    packs: Mutex<Packs>,
}

#[derive(Default)]
struct Packs {
    loaded: BTreeSet<String>,
    places: HashMap<Digest, Place>,
}

#[derive(Clone)]
struct Place {
    pack: Arc<str>,
    offset: u64,
    len: u32,
}

/// How many blobs of each form there are.
pub(super) struct Count {
    pub(super) loose: u64,
    pub(super) loose_bytes: u64,
    pub(super) packs: u64,
    pub(super) packed: u64,
    pub(super) packed_bytes: u64,
    pub(super) quarantined: u64,
}

impl Shelf {
    pub(super) fn new(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
            packs: Mutex::default(),
        }
    }

    pub(super) fn packs_dir(&self) -> PathBuf {
        self.root.join("packs")
    }

    pub(super) fn loose_path(&self, digest: &Digest) -> PathBuf {
        let hex = digest.to_string();
        self.root.join("cas").join(&hex[..2]).join(&hex[2..])
    }

    fn bad_path(&self, name: &str) -> PathBuf {
        self.root.join("bad").join(name)
    }

    fn packs(&self) -> MutexGuard<'_, Packs> {
        self.packs.lock()
    }

    fn place(&self, digest: &Digest) -> Option<Place> {
        self.packs().places.get(digest).cloned()
    }

    /// Tells whether a blob is here as far as we know, without looking for other processes' packs.
    pub(super) fn knows(&self, digest: &Digest) -> bool {
        self.place(digest).is_some() || self.loose_path(digest).exists()
    }

    /// Returns a blob's length in bytes.
    pub(super) fn size_of(&self, digest: &Digest) -> Option<u64> {
        let known = |shelf: &Self| shelf.place(digest).map(|place| u64::from(place.len));
        known(self)
            .or_else(|| Some(fs::metadata(self.loose_path(digest)).ok()?.len()))
            .or_else(|| self.refresh().ok().and_then(|()| known(self)))
    }

    /// Reads and verifies a blob; one whose bytes are wrong is set aside.
    pub(super) fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StoreError> {
        if let Some(place) = self.place(digest) {
            return self.get_packed(digest, &place);
        }
        let path = self.loose_path(digest);
        match fs::read(&path) {
            Ok(bytes) if Digest::of(&bytes) == *digest => return Ok(Arc::from(bytes)),
            Ok(_) => return Err(self.set_loose_aside(digest, &path)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(StoreError::io("read", path)(error)),
        }
        self.refresh()?;
        match self.place(digest) {
            Some(place) => self.get_packed(digest, &place),
            None => Err(StoreError::Missing { digest: *digest }),
        }
    }

    fn get_packed(&self, digest: &Digest, place: &Place) -> Result<Arc<[u8]>, StoreError> {
        let path = self.packs_dir().join(format!("{}.pack", place.pack));
        let bytes = match pack::read(&path, place.offset, place.len) {
            Err(error)
                if !matches!(
                    error.kind(),
                    io::ErrorKind::NotFound | io::ErrorKind::UnexpectedEof
                ) =>
            {
                return Err(StoreError::io("read", path)(error));
            }
            // A pack that is gone or cut short: as damaged as one with a flipped bit.
            read => read.unwrap_or_default(),
        };
        if Digest::of(&bytes) == *digest {
            return Ok(Arc::from(bytes));
        }
        Err(self.set_packed_aside(digest, place, &bytes))
    }

    fn set_loose_aside(&self, digest: &Digest, path: &Path) -> StoreError {
        let aside = self.bad_path(&digest.to_string());
        let moved = files::create_dir(&self.bad_path(""))
            .and_then(|()| fs::rename(path, &aside).map_err(StoreError::io("set aside", path)));
        match moved {
            Ok(()) => StoreError::Damaged {
                digest: *digest,
                path: aside,
            },
            Err(error) => error,
        }
    }

    /// A pack is never changed: the file under `bad/` also says that this pack's copy is not to be used.
    fn set_packed_aside(&self, digest: &Digest, place: &Place, bytes: &[u8]) -> StoreError {
        let aside = self.bad_path(&format!("{digest}.{}", place.pack));
        let written = files::create_dir(&self.bad_path("")).and_then(|()| match aside.exists() {
            true => Ok(()),
            false => files::write_new(&aside, &[bytes]),
        });
        self.packs().places.remove(digest);
        match written {
            Ok(()) => StoreError::Damaged {
                digest: *digest,
                path: aside,
            },
            Err(error) => error,
        }
    }

    /// Takes up a pack that we have just sealed.
    pub(super) fn add(&self, name: &str, entries: &[pack::Entry]) {
        let mut packs = self.packs();
        packs.take_up(name, entries, &BTreeSet::new());
    }

    /// Takes up packs that appeared since the last look.
    pub(super) fn refresh(&self) -> Result<(), StoreError> {
        let listed = files::names(&self.packs_dir())?;
        let mut packs = self.packs();
        let new: Vec<&str> = listed
            .iter()
            .filter_map(|name| name.strip_suffix(".pack"))
            .filter(|name| !packs.loaded.contains(*name))
            .collect();
        if new.is_empty() {
            return Ok(());
        }
        let bad: BTreeSet<String> = files::names(&self.bad_path(""))?.into_iter().collect();
        for name in new {
            let entries = pack::load(&self.packs_dir().join(format!("{name}.pack")))?;
            packs.take_up(name, &entries, &bad);
        }
        Ok(())
    }

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
        let packs = self.packs();
        Ok(Count {
            loose,
            loose_bytes,
            packs: packs.loaded.len() as u64,
            packed: packs.places.len() as u64,
            packed_bytes: packs.places.values().map(|place| u64::from(place.len)).sum(),
            quarantined: files::names(&self.bad_path(""))?.len() as u64,
        })
    }
}

impl Packs {
    fn take_up(&mut self, name: &str, entries: &[pack::Entry], bad: &BTreeSet<String>) {
        let pack: Arc<str> = Arc::from(name);
        for entry in entries {
            if !bad.is_empty() && bad.contains(&format!("{}.{name}", entry.digest)) {
                continue;
            }
            let place = Place {
                pack: Arc::clone(&pack),
                offset: entry.offset,
                len: entry.len,
            };
            self.places.entry(entry.digest).or_insert(place);
        }
        self.loaded.insert(name.to_owned());
    }
}
