//! Entries of the files of a folder from earlier runs. A file whose state is unchanged is not read. The table is in
//! the scratch folder, and its loss costs only time.
//!
//! ```text
//! table   entries by name, then the digest of all of it
//! entry   u16 bytes shared with the name before, u16 bytes of the rest, the rest, u8 kind, u32 sol (all ones: none),
//!         32 bytes digest, u64 size, i64 mtime_ns, i64 ctime_ns, u64 inode, u64 device (all little-endian)
//! ```
//! A file is not in the table if it was written less than one tick of the coarsest file systems before it was read.
//! Within that tick it could be written again without a trace in its state.

use std::path::{Path, PathBuf};

use marf_cache::Digest;

use super::walk::Names;
use crate::archive::{Kind, Known, kind};
use crate::files::{read_checked, write_checked};
use crate::stat::FileState;

/// Raised when an entry has another form, or kind or sol of a file may be read differently.
const FORM: u32 = 4;
const NO_SOL: u32 = u32::MAX;

/// What of a file is kept, small: a folder may hold millions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Entry {
    /// What the file is.
    pub kind: EntryKind,
    /// Digest of its bytes, or of the reason why it cannot be read.
    pub digest: Digest,
    /// Its sol, where the name or its own label has it.
    pub sol: Option<u32>,
}

/// As [`Kind`], without reasons.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EntryKind {
    Photo,
    Raw,
    Pds4,
    Feed,
    Odl,
    /// The reason follows from the name.
    Other,
    /// Number of the reason in a list.
    Unreadable(u32),
}

impl Entry {
    /// Returns the entry of a file that was read.
    pub fn from_known(known: &Known) -> Option<Self> {
        let kind = match known.kind {
            Kind::Photo => EntryKind::Photo,
            Kind::Raw => EntryKind::Raw,
            Kind::Pds4 => EntryKind::Pds4,
            Kind::Feed => EntryKind::Feed,
            Kind::Odl => EntryKind::Odl,
            Kind::Other(_) => EntryKind::Other,
            Kind::Unreadable(_) => return None,
        };
        Some(Self {
            kind,
            digest: known.digest,
            sol: known.sol,
        })
    }

    /// Whether the file may be a photo.
    pub fn is_photo(&self) -> bool {
        matches!(self.kind, EntryKind::Photo | EntryKind::Raw)
    }

    /// Returns the facts of this entry for a file of this name. `None` if the file cannot be read.
    pub fn known(&self, name: &str) -> Option<Known> {
        let kind = match self.kind {
            EntryKind::Photo => Kind::Photo,
            EntryKind::Raw => Kind::Raw,
            EntryKind::Pds4 => Kind::Pds4,
            EntryKind::Feed => Kind::Feed,
            EntryKind::Odl => Kind::Odl,
            EntryKind::Other => kind(name, &[]),
            EntryKind::Unreadable(_) => return None,
        };
        Some(Known {
            kind,
            digest: self.digest,
            sol: self.sol,
        })
    }
}

/// Returns the path of the table of a folder. `None` without a scratch folder.
pub(super) fn path(scratch: &Path, root: &Path, depth: usize) -> Option<PathBuf> {
    if scratch.as_os_str().is_empty() {
        return None;
    }
    let root = std::fs::canonicalize(root).unwrap_or_else(|_| root.to_owned());
    let key = format!("folder {FORM} {depth}\n{}", root.to_string_lossy());
    let name = Digest::from_content(key.as_bytes()).to_string();
    Some(scratch.join("folders").join(name))
}

/// Reads a table from its start to its end.
#[derive(Default)]
pub(super) struct Reader {
    bytes: Vec<u8>,
    at: usize,
    name: Vec<u8>,
    next: Option<(FileState, Entry)>,
    /// Number of entries that were read.
    read: usize,
}

impl Reader {
    /// Opens a table. A lost or damaged one is empty.
    pub fn open(path: &Path) -> Self {
        let mut reader = Self {
            bytes: read_checked(path).unwrap_or_default(),
            ..Self::default()
        };
        reader.advance();
        reader
    }

    /// Returns the entry of a file, if it is known in this state. Names must come in their order.
    pub fn find(&mut self, name: &str, state: &FileState) -> Option<Entry> {
        while self.next.is_some() && self.name.as_slice() < name.as_bytes() {
            self.advance();
        }
        let (known, entry) = self.next.as_ref()?;
        (self.name == name.as_bytes() && known == state).then_some(*entry)
    }

    /// Returns the number of entries, those that were not asked for included.
    pub fn count(mut self) -> usize {
        while self.next.is_some() {
            self.advance();
        }
        self.read
    }

    fn advance(&mut self) {
        self.next = self.entry();
        self.read += usize::from(self.next.is_some());
    }

    fn entry(&mut self) -> Option<(FileState, Entry)> {
        let shared = usize::from(u16::from_le_bytes(self.take()?));
        let rest = usize::from(u16::from_le_bytes(self.take()?));
        self.name.truncate(shared);
        let end = self.at.checked_add(rest)?;
        self.name.extend_from_slice(self.bytes.get(self.at..end)?);
        self.at = end;
        let [tag] = self.take()?;
        let sol = u32::from_le_bytes(self.take()?);
        let entry = Entry {
            kind: KINDS.get(usize::from(tag)).copied()?,
            sol: (sol != NO_SOL).then_some(sol),
            digest: Digest::from_bytes(self.take()?),
        };
        let state = FileState {
            size: u64::from_le_bytes(self.take()?),
            mtime_ns: i64::from_le_bytes(self.take()?),
            ctime_ns: i64::from_le_bytes(self.take()?),
            inode: u64::from_le_bytes(self.take()?),
            device: u64::from_le_bytes(self.take()?),
        };
        Some((state, entry))
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let bytes = self.bytes.get(self.at..self.at + N)?;
        self.at += N;
        bytes.try_into().ok()
    }
}

/// Kinds by their number in an entry.
const KINDS: [EntryKind; 6] = [
    EntryKind::Photo,
    EntryKind::Raw,
    EntryKind::Pds4,
    EntryKind::Feed,
    EntryKind::Odl,
    EntryKind::Other,
];

/// Writes the table of the files that had rested at `began_ns`, before the first of them was read.
pub(super) fn write(
    path: &Path,
    names: &Names,
    files: &[Result<FileState, String>],
    entries: &[Entry],
    began_ns: i64,
) {
    let mut bytes = Vec::new();
    let mut before: &[u8] = &[];
    for (index, (state, entry)) in files.iter().zip(entries).enumerate() {
        let name = names.get(index).as_bytes();
        let Some((state, tag)) = kept(name, state, entry, began_ns) else {
            continue;
        };
        let shared = name.iter().zip(before).take_while(|(a, b)| a == b).count();
        bytes.extend((shared as u16).to_le_bytes());
        bytes.extend(((name.len() - shared) as u16).to_le_bytes());
        bytes.extend_from_slice(&name[shared..]);
        bytes.push(tag);
        bytes.extend(entry.sol.unwrap_or(NO_SOL).to_le_bytes());
        bytes.extend_from_slice(entry.digest.as_bytes());
        bytes.extend(state.size.to_le_bytes());
        bytes.extend(state.mtime_ns.to_le_bytes());
        bytes.extend(state.ctime_ns.to_le_bytes());
        bytes.extend(state.inode.to_le_bytes());
        bytes.extend(state.device.to_le_bytes());
        before = name;
    }
    write_checked(path, bytes);
}

/// Returns the state and the tag to keep for a file. `None` if it must be read again.
fn kept(
    name: &[u8],
    state: &Result<FileState, String>,
    entry: &Entry,
    began_ns: i64,
) -> Option<(FileState, u8)> {
    let state = state.as_ref().ok().filter(|state| state.rested(began_ns))?;
    let tag = KINDS.iter().position(|kind| *kind == entry.kind)?;
    let short = u16::try_from(name.len()).is_ok() && entry.sol != Some(NO_SOL);
    short.then_some((*state, tag as u8))
}

/// Whether a table would have an entry for a file.
pub(super) fn is_kept(state: &Result<FileState, String>, entry: &Entry, began_ns: i64) -> bool {
    kept(b"", state, entry, began_ns).is_some()
}
