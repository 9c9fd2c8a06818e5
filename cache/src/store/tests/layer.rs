//! A file layer that fails a call, or crashes at one and loses what was not synced.

use std::{
    collections::BTreeMap,
    io,
    sync::atomic::{AtomicUsize, Ordering},
    time::SystemTime,
};

use super::{
    super::files::{Disk, Meta, Operations, PublishResult},
    *,
};

/// What happens at the chosen call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mishap {
    /// The call fails, those after it do not.
    Fail(io::ErrorKind),
    /// The call and all after it fail, and what was not synced is lost.
    Crash,
}

/// A change of a folder that is not on the disk yet.
enum Change {
    Created(PathBuf),
    Renamed(PathBuf, PathBuf),
    Removed(PathBuf, PathBuf),
}

impl Change {
    fn folder(&self) -> Option<&Path> {
        match self {
            Self::Created(path) | Self::Renamed(_, path) | Self::Removed(path, _) => path.parent(),
        }
    }
}

/// Unsynced changes, which a crash discards.
#[derive(Default)]
struct Unsynced {
    changes: Vec<Change>,
    /// Files with unsynced bytes, and how many of their bytes are synced.
    bytes: BTreeMap<PathBuf, u64>,
}

/// The layer.
pub(super) struct Faulty {
    calls: AtomicUsize,
    at: usize,
    mishap: Mishap,
    unsynced: Mutex<Unsynced>,
    /// Where removed files are kept, because a crash may bring them back.
    removed: PathBuf,
}

impl Faulty {
    pub(super) fn new(at: usize, mishap: Mishap, removed: &Path) -> Arc<Self> {
        fs::create_dir_all(removed).unwrap();
        Arc::new(Self {
            calls: AtomicUsize::new(0),
            at,
            mishap,
            unsynced: Mutex::default(),
            removed: removed.to_owned(),
        })
    }

    pub(super) fn calls(&self) -> usize {
        self.calls.load(Ordering::SeqCst)
    }

    fn call(&self) -> io::Result<usize> {
        let call = self.calls.fetch_add(1, Ordering::SeqCst);
        match self.mishap {
            Mishap::Fail(kind) if call == self.at => Err(kind.into()),
            Mishap::Crash if call >= self.at => Err(io::Error::other("crashed")),
            _ => Ok(call),
        }
    }

    /// Discards everything that was not synced. A disk may have written some of it, in any order: of every file none, half or all of
    /// its bytes, of every folder its first changes. The call of the crash determines what had been written. At every fourth it is
    /// nothing.
    pub(super) fn lose_unsynced(&self) {
        let mut unsynced = self.unsynced.lock();
        for (file, (path, synced)) in std::mem::take(&mut unsynced.bytes).into_iter().enumerate() {
            let Ok(bytes) = fs::read(&path) else { continue };
            let written = bytes.len().saturating_sub(synced as usize);
            let kept = synced as usize + written * self.draw(file, 3) / 2;
            replace(&path, &bytes[..kept]);
        }
        let changes = std::mem::take(&mut unsynced.changes);
        let mut by_folder: BTreeMap<PathBuf, usize> = BTreeMap::new();
        for change in &changes {
            *by_folder.entry(change.folder().unwrap().to_owned()).or_default() += 1;
        }
        for (folder, number) in by_folder.values_mut().enumerate() {
            *number -= self.draw(folder, *number + 1);
        }
        for change in changes.into_iter().rev() {
            let lost = by_folder.get_mut(change.folder().unwrap()).unwrap();
            if *lost == 0 {
                continue;
            }
            *lost -= 1;
            match change {
                Change::Created(path) if path.is_dir() => drop(fs::remove_dir_all(path)),
                Change::Created(path) => drop(fs::remove_file(path)),
                Change::Renamed(from, to) => drop(fs::rename(to, from)),
                Change::Removed(path, saved) => drop(fs::hard_link(saved, path)),
            }
        }
    }

    /// Returns a number below `end` that depends on the call of the crash and the number of a file. 0 at every fourth call.
    fn draw(&self, file: usize, end: usize) -> usize {
        if self.at.is_multiple_of(4) {
            return 0;
        }
        let drawn = Digest::from_content(format!("{} {file}", self.at).as_bytes());
        usize::from(drawn.as_bytes()[0]) % end
    }

    fn changed(&self, change: Change) {
        self.unsynced.lock().changes.push(change);
    }

    fn wrote(&self, path: &Path, synced: u64) {
        self.unsynced
            .lock()
            .bytes
            .entry(path.to_owned())
            .or_insert(synced);
    }

    /// The bytes of a file have another name now too.
    fn named(&self, from: &Path, to: &Path) {
        let mut unsynced = self.unsynced.lock();
        if let Some(synced) = unsynced.bytes.get(from).copied() {
            unsynced.bytes.insert(to.to_owned(), synced);
        }
    }
}

impl Operations for Faulty {
    fn create_dir(&self, path: &Path) -> io::Result<()> {
        self.call()?;
        let mut new: Vec<&Path> = path.ancestors().take_while(|path| !path.exists()).collect();
        Disk.create_dir(path)?;
        new.reverse();
        new.into_iter()
            .for_each(|path| self.changed(Change::Created(path.to_owned())));
        Ok(())
    }

    fn write_new(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let failed = self.call();
        self.wrote(path, 0);
        self.changed(Change::Created(path.to_owned()));
        match failed {
            // A full disk takes a part.
            Err(error) => {
                let _ = Disk.write_new(path, &bytes[..bytes.len() / 2]);
                Err(error)
            }
            Ok(_) => Disk.write_new(path, bytes),
        }
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let failed = self.call();
        if !path.exists() {
            self.changed(Change::Created(path.to_owned()));
        }
        self.wrote(path, fs::metadata(path).map_or(0, |meta| meta.len()));
        match failed {
            Err(error) => {
                let _ = Disk.append(path, &bytes[..bytes.len() / 2]);
                Err(error)
            }
            Ok(_) => Disk.append(path, bytes),
        }
    }

    fn reflink(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.call()?;
        Disk.reflink(from, to)?;
        self.wrote(to, 0);
        self.changed(Change::Created(to.to_owned()));
        Ok(())
    }

    fn reference(&self, target: &Path, link: &Path) -> io::Result<()> {
        self.call()?;
        Disk.reference(target, link)?;
        self.changed(Change::Created(link.to_owned()));
        Ok(())
    }

    fn seal(&self, path: &Path) -> io::Result<()> {
        self.call()?;
        Disk.seal(path)
    }

    fn sync_file(&self, path: &Path) -> io::Result<()> {
        self.call()?;
        fs::metadata(path)?;
        self.unsynced.lock().bytes.remove(path);
        Ok(())
    }

    fn sync_dir(&self, path: &Path) -> io::Result<()> {
        self.call()?;
        fs::metadata(path)?;
        let mut unsynced = self.unsynced.lock();
        unsynced.changes.retain(|change| change.folder() != Some(path));
        Ok(())
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<PublishResult> {
        self.call()?;
        let published = Disk.link(from, to)?;
        if published == PublishResult::New {
            self.named(from, to);
            self.changed(Change::Created(to.to_owned()));
        }
        Ok(published)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.call()?;
        Disk.rename(from, to)?;
        self.named(from, to);
        self.changed(Change::Renamed(from.to_owned(), to.to_owned()));
        Ok(())
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        let call = self.call()?;
        let saved = self.removed.join(call.to_string());
        let is_saved = fs::hard_link(path, &saved).is_ok();
        Disk.remove_file(path)?;
        if is_saved {
            self.changed(Change::Removed(path.to_owned(), saved));
        }
        Ok(())
    }

    fn remove_dir_all(&self, path: &Path) -> io::Result<()> {
        self.call()?;
        Disk.remove_dir_all(path)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        self.call()?;
        Disk.read(path)
    }

    fn read_at(&self, path: &Path, offset: u64, len: usize) -> io::Result<Vec<u8>> {
        self.call()?;
        Disk.read_at(path, offset, len)
    }

    fn names(&self, dir: &Path) -> io::Result<Vec<String>> {
        self.call()?;
        Disk.names(dir)
    }

    fn meta(&self, path: &Path) -> io::Result<Meta> {
        self.call()?;
        Disk.meta(path)
    }

    fn set_modified(&self, path: &Path, time: SystemTime) -> io::Result<()> {
        self.call()?;
        Disk.set_modified(path, time)
    }
}
