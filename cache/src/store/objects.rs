//! Committed objects: loose files under `cas/`, entries of packs, and what is done with damaged ones.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
    sync::Arc,
};

use parking_lot::Mutex;

use super::{
    error::StoreError,
    files::{Access, Files, Meta},
    index::{Index, Location},
    lease::Lease,
    locks::{Lock, Locks, Share},
    notices::Notices,
    pack::{self, Contents, Entry, Kind, Window},
    staging::StagingDir,
};
use crate::{Digest, file::is_irregular};

/// Attempts to read an object whose pack others rewrite at the same time.
const ATTEMPTS: usize = 6;
/// Wait for the rows of packs whose files are gone.
const REFRESH_PATIENCE: std::time::Duration = std::time::Duration::from_secs(5);

/// First bytes of a set: its root names blocks.
const SET_START: &[u8] = b"{\"block\":";
/// First bytes of a leaf of rows.
const LEAF_START: &[u8] = b"{\"id\":";

/// All committed objects of a store, also those that other processes add.
pub(super) struct Objects {
    pub(super) root: PathBuf,
    pub(super) files: Files,
    pub(super) locks: Arc<Locks>,
    pub(super) notices: Arc<Notices>,
    pub(super) access: Access,
    pub(super) index: Index,
    pub(super) lease: Lease,
    staging: Mutex<Option<Arc<StagingDir>>>,
    /// Objects found damaged in a store that cannot be repaired because it cannot be written.
    lost: Mutex<HashSet<(Kind, Digest)>>,
}

/// Result of checking a pack.
pub(super) enum PackCheck {
    /// The file is gone: another process has rewritten it.
    Gone,
    /// Every entry is whole.
    Whole,
    /// The table or these entries are damaged.
    Damaged(Vec<Entry>),
}

impl Objects {
    /// Opens the objects in the folder of a store.
    pub(super) fn open(
        root: &Path,
        access: Access,
        files: Files,
        notices: Arc<Notices>,
    ) -> Result<Self, StoreError> {
        let locks = Arc::new(Locks::new(root));
        let index = Index::open(
            root,
            access,
            files.clone(),
            Arc::clone(&locks),
            Arc::clone(&notices),
        )?;
        Ok(Self {
            root: root.to_owned(),
            lease: Lease::new(root, files.clone(), access),
            files,
            locks,
            notices,
            access,
            index,
            staging: Mutex::default(),
            lost: Mutex::default(),
        })
    }

    pub(super) fn pack_path(&self, file: &str) -> PathBuf {
        self.root.join("packs").join(file)
    }

    /// Returns the path of a blob that is a file of its own.
    pub(super) fn loose_path(&self, digest: &Digest) -> PathBuf {
        let hex = digest.to_string();
        let (folder, name) = hex.split_at(2);
        self.root.join("cas").join(folder).join(name)
    }

    /// Returns the folder of temporary files. The first write creates it, so that a reader writes nothing.
    pub(super) fn staging(&self) -> Result<Arc<StagingDir>, StoreError> {
        let mut staging = self.staging.lock();
        if let Some(staging) = staging.as_ref() {
            return Ok(Arc::clone(staging));
        }
        let tmp = self.root.join("tmp");
        if self.access == Access::ReadOnly {
            let denied = std::io::Error::from(std::io::ErrorKind::PermissionDenied);
            return Err(StoreError::io("write to", &self.root)(denied));
        }
        let created = Arc::new(StagingDir::create(&self.files, &tmp, &self.notices)?);
        *staging = Some(Arc::clone(&created));
        Ok(created)
    }

    fn is_lost(&self, kind: Kind, id: &Digest) -> bool {
        self.access == Access::ReadOnly && self.lost.lock().contains(&(kind, *id))
    }

    fn locate(&self, kind: Kind, id: &Digest) -> Result<Option<Location>, StoreError> {
        let location = self.index.locate(kind, id)?;
        Ok(location.filter(|_| !self.is_lost(kind, id)))
    }

    /// Returns whether a blob is stored, without a look for packs that other processes added.
    pub(super) fn knows(&self, digest: &Digest) -> bool {
        let packed = self.index.locate_known(Kind::Blob, digest);
        packed.is_ok_and(|location| location.is_some()) || self.files.meta(&self.loose_path(digest)).is_some()
    }

    /// Returns whether a blob is stored. Its bytes are not read.
    pub(super) fn contains(&self, digest: &Digest) -> bool {
        let loose = || self.files.meta(&self.loose_path(digest)).is_some();
        let packed = self.locate(Kind::Blob, digest);
        packed.is_ok_and(|location| location.is_some()) || loose() && !self.is_lost(Kind::Blob, digest)
    }

    /// Returns a blob's length in bytes, as its pack or its file has it.
    pub(super) fn size_of(&self, digest: &Digest) -> Option<u64> {
        for _ in 0..ATTEMPTS {
            let Some(location) = self.locate(Kind::Blob, digest).ok().flatten() else {
                break;
            };
            let entry = Entry {
                kind: Kind::Blob,
                id: *digest,
                offset: location.offset,
                len: location.len,
                generation: 0,
            };
            let path = self.pack_path(&location.file);
            // The index does not prove a length, but the head of the entry does.
            if matches!(pack::has_head(&self.files, &path, &entry), Ok(true)) {
                return Some(u64::from(location.len));
            }
            match self.files.meta(&path) {
                None => drop(self.index.refresh(REFRESH_PATIENCE)),
                Some(_) => drop(self.heal(Kind::Blob, digest, &location)),
            }
        }
        let loose = self.files.meta(&self.loose_path(digest))?;
        (!self.is_lost(Kind::Blob, digest)).then_some(loose.bytes)
    }

    /// Reads and verifies a blob. A damaged one is quarantined.
    pub(super) fn get(&self, digest: &Digest) -> Result<Arc<[u8]>, StoreError> {
        let missing = || StoreError::Missing { digest: *digest };
        if self.is_lost(Kind::Blob, digest) {
            return Err(missing());
        }
        let path = self.loose_path(digest);
        if let Some(bytes) = self.files.read(&path)? {
            return if Digest::from_content(&bytes) == *digest {
                Ok(Arc::from(bytes))
            } else {
                Err(self.quarantine_loose(digest, &path))
            };
        }
        let packed = self.payload(Kind::Blob, digest)?;
        packed.map(Arc::from).ok_or_else(missing)
    }

    /// Returns the first bytes of a blob, unverified: enough to recognise its form.
    pub(super) fn peek(&self, digest: &Digest, len: usize) -> Result<Option<Vec<u8>>, StoreError> {
        match self.files.read_at(&self.loose_path(digest), 0, len) {
            Err(StoreError::Io { source, .. }) if is_irregular(&source) => return Ok(Some(Vec::new())),
            Ok(None) => {}
            read => return read,
        }
        let Some(location) = self.locate(Kind::Blob, digest)? else {
            return Ok(None);
        };
        let len = len.min(location.len as usize);
        self.files
            .read_at(&self.pack_path(&location.file), location.offset, len)
    }

    /// Returns whether a blob begins as the root of a set does.
    pub(super) fn is_set(&self, digest: &Digest) -> Result<bool, StoreError> {
        Ok(self.peek(digest, SET_START.len())?.as_deref() == Some(SET_START))
    }

    /// Returns whether a blob begins as a leaf of rows does.
    pub(super) fn is_leaf(&self, digest: &Digest) -> Result<bool, StoreError> {
        Ok(self.peek(digest, LEAF_START.len())?.as_deref() == Some(LEAF_START))
    }

    /// Reads an entry of a pack and returns its content if it is whole. Repairs nothing.
    pub(super) fn whole_payload(&self, kind: Kind, id: &Digest) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(location) = self.locate(kind, id)? else {
            return Ok(None);
        };
        let path = self.pack_path(&location.file);
        let bytes = self
            .files
            .read_at(&path, location.offset, location.len as usize)?;
        Ok(bytes.and_then(|bytes| pack::open(kind, id, &bytes).map(<[u8]>::to_vec)))
    }

    /// Moves a damaged loose blob to the quarantine.
    pub(super) fn quarantine_loose(&self, digest: &Digest, path: &Path) -> StoreError {
        let moved = match self.access {
            Access::ReadWrite => self.files.quarantine(&self.root, path, &digest.to_string()),
            Access::ReadOnly => {
                self.lost.lock().insert((Kind::Blob, *digest));
                Ok(path.to_owned())
            }
        };
        moved.map_or_else(
            |error| error,
            |path| StoreError::Damaged {
                digest: *digest,
                path,
            },
        )
    }

    /// Reads and verifies an entry of a pack and returns its content, or `None` if there is no entry.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] once: the damaged entry is quarantined and then missing.
    pub(super) fn payload(&self, kind: Kind, id: &Digest) -> Result<Option<Vec<u8>>, StoreError> {
        let mut damaged = None;
        for attempt in 0..ATTEMPTS {
            let Some(location) = self.locate(kind, id)? else {
                break;
            };
            let path = self.pack_path(&location.file);
            match self
                .files
                .read_at(&path, location.offset, location.len as usize)?
            {
                // Another process has merged or collected the pack: the index knows where its objects are now.
                None if attempt == 0 => {}
                None => drop(self.index.refresh(REFRESH_PATIENCE)?),
                Some(bytes) => match pack::open(kind, id, &bytes) {
                    Some(content) => return Ok(Some(content.to_vec())),
                    None => damaged = self.heal(kind, id, &location)?.or(damaged),
                },
            }
        }
        match damaged {
            Some(path) => Err(StoreError::Damaged { digest: *id, path }),
            None => Ok(None),
        }
    }

    /// Repairs what made an entry unreadable: its pack, or else the index. Returns where a damaged pack is now.
    fn heal(&self, kind: Kind, id: &Digest, location: &Location) -> Result<Option<PathBuf>, StoreError> {
        if self.access == Access::ReadOnly {
            self.lost.lock().insert((kind, *id));
            return Ok(Some(self.pack_path(&location.file)));
        }
        let guard = self.locks.take(Lock::Rewrite, Share::Exclusive, &self.notices)?;
        // Another thread or process may have healed it meanwhile.
        if self.index.locate(kind, id)?.as_ref() != Some(location) {
            return Ok(None);
        }
        let (contents, checked) = self.check_pack(&location.file)?;
        match (contents, checked) {
            (Some(contents), PackCheck::Damaged(bad)) => self
                .replace_pack(&guard, &location.file, &contents, &bad)
                .map(Some),
            (_, PackCheck::Gone) => self.index.refresh(REFRESH_PATIENCE).map(|_| None),
            _ => self
                .index
                .rebuild("it gives a wrong place for an object")
                .map(|()| None),
        }
    }

    /// Verifies every entry of a pack.
    pub(super) fn check_pack(&self, file: &str) -> Result<(Option<Contents>, PackCheck), StoreError> {
        let path = self.pack_path(file);
        let Some(contents) = pack::contents(&self.files, &path)? else {
            return Ok((None, PackCheck::Gone));
        };
        let mut window = Window::new(&self.files, &path);
        let mut bad = Vec::new();
        for entry in &contents.entries {
            let is_whole = pack::open(entry.kind, &entry.id, window.payload(entry)?).is_some()
                && window.has_head(entry)?;
            if !is_whole {
                bad.push(*entry);
            }
        }
        let checked = if bad.is_empty() && contents.has_table {
            PackCheck::Whole
        } else {
            PackCheck::Damaged(bad)
        };
        Ok((Some(contents), checked))
    }

    /// Writes the whole entries of a pack to a new one and quarantines the pack. Returns its new path.
    pub(super) fn replace_pack(
        &self,
        _rewriting: &super::locks::Guard,
        file: &str,
        contents: &Contents,
        bad: &[Entry],
    ) -> Result<PathBuf, StoreError> {
        let damaged: HashSet<u64> = bad.iter().map(|entry| entry.offset).collect();
        let whole = |entry: &Entry| !damaged.contains(&entry.offset);
        let entries = self.rewrite_entries(file, contents.entries.iter().filter(|entry| whole(entry)))?;
        let (name, entries) = entries.unwrap_or_default();
        let is_known = if name.is_empty() {
            self.index.forget(&[file.to_owned()].into())?
        } else {
            self.index.rewrite(file, &name, &entries)?
        };
        let to = self.files.quarantine(&self.root, &self.pack_path(file), file)?;
        if !is_known {
            self.index.refresh(REFRESH_PATIENCE)?;
        }
        self.notices.warn(format!(
            "a damaged pack was moved to `{}`. {} of its {} objects are whole and stay",
            to.display(),
            entries.len(),
            entries.len() + bad.len()
        ));
        Ok(to)
    }

    /// Writes entries of a pack to a new pack, durably, and returns its name and entries. Returns `None` if there
    /// are no entries.
    pub(super) fn rewrite_entries<'a>(
        &self,
        file: &str,
        wanted: impl Iterator<Item = &'a Entry>,
    ) -> Result<Option<(String, Vec<Entry>)>, StoreError> {
        let mut wanted = wanted.peekable();
        if wanted.peek().is_none() {
            return Ok(None);
        }
        let staging = self.staging()?;
        let name = format!("{}.pack", staging.next_name());
        let temporary = staging.path(&name);
        let path = self.pack_path(file);
        let mut window = Window::new(&self.files, &path);
        let mut writer = pack::Writer::new(&self.files, &temporary);
        for entry in wanted {
            writer.add(entry.kind, &entry.id, window.payload(entry)?)?;
        }
        let entries = writer.finish()?;
        self.publish_pack(&temporary, &name)?;
        if let Some(meta) = self.files.meta(&path) {
            self.files.set_modified(&self.pack_path(&name), meta.modified);
        }
        Ok(Some((name, entries)))
    }

    /// Gives a finished temporary pack its name, durably.
    pub(super) fn publish_pack(&self, temporary: &Path, name: &str) -> Result<(), StoreError> {
        self.files.sync_files(&[temporary.to_owned()])?;
        self.files.publish(temporary, &self.pack_path(name))?;
        self.files.sync_dirs(&[self.root.join("packs")])
    }

    /// Returns all loose blobs with length and place of their bytes, folder by folder.
    pub(super) fn for_each_loose(&self, mut each: impl FnMut(Digest, Meta)) -> Result<(), StoreError> {
        let cas = self.root.join("cas");
        for folder in self.files.names(&cas)? {
            let dir = cas.join(&folder);
            for name in self.files.names(&dir)? {
                let Ok(digest) = format!("{folder}{name}").parse::<Digest>() else {
                    continue;
                };
                if let Some(meta) = self.files.meta(&dir.join(&name)) {
                    each(digest, meta);
                }
            }
        }
        Ok(())
    }
}
