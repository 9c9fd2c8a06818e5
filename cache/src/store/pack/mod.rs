//! Packs: many small blobs, records and memos in one file that never changes.
//!
//! A pack is `marf-pack-2\n`; the body: for each entry its kind (u8: 0 blob, 1 record, 2 memo), its id (32 bytes), the
//! length of its payload (u32 LE), the payload; the table: for each entry kind, id, offset of the payload (u64 LE),
//! length (u32 LE), generation (u32 LE); last the offset of the table (u64 LE), the blake3 of table and offset, and
//! `marf-pend-2\n`. Without a valid table the entries are found by a scan of the body.
//!
//! The payload of a blob is its bytes. That of a record or memo is the blake3 of (kind, id, rest), then the rest: the
//! generation (u32 LE), and the JSON of the record or the blob and the maker of the memo. Of two entries of one key
//! that of the higher generation is valid.
//!
//! Packs of 0.1.0 (`marf-pack-1\n`) hold blobs only, without kinds, and their table in a file `.idx` beside them.

mod read;

use std::path::Path;

use super::{error::StoreError, files::Files};
use crate::Digest;

pub(super) use read::{Window, contents, has_head};

const MAGIC: &[u8; 12] = b"marf-pack-2\n";
const END: &[u8; 12] = b"marf-pend-2\n";
const OLD_MAGIC: &[u8; 12] = b"marf-pack-1\n";
const OLD_INDEX: &[u8; 12] = b"marf-pidx-1\n";
const DIGEST: usize = 32;
/// Bytes of kind, id and length.
const HEAD: usize = 1 + DIGEST + 4;
const OLD_HEAD: usize = DIGEST + 4;
const ROW: usize = 1 + DIGEST + 8 + 4 + 4;
const OLD_ROW: usize = DIGEST + 8 + 4;
/// Bytes of the offset of the table, its digest and the closing magic.
const TAIL: usize = 8 + DIGEST + 12;
/// Bytes of checksum and generation at the start of the payload of a record or memo.
const SEALED_HEAD: usize = DIGEST + 4;
/// Bytes read and written at once.
const CHUNK: usize = 8 << 20;

/// Bytes of a pack that an object takes beside its payload.
pub(super) const OVERHEAD: u64 = (HEAD + ROW) as u64;

/// Offset of the first entry of a pack.
pub(super) const BODY: u64 = 12;

/// What an entry of a pack is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Kind {
    Blob,
    Record,
    Memo,
}

/// An entry of a pack: what it is, and offset and length of its payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) kind: Kind,
    pub(super) id: Digest,
    pub(super) offset: u64,
    pub(super) len: u32,
    pub(super) generation: u32,
}

/// The form of a pack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// `marf-pack-2`.
    Current,
    /// `marf-pack-1`, of 0.1.0.
    Old,
}

/// The entries of a pack.
pub(super) struct Contents {
    pub(super) form: Form,
    pub(super) entries: Vec<Entry>,
    /// False if the table was damaged, so that the body was scanned.
    pub(super) has_table: bool,
}

impl Kind {
    pub(super) fn of(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Blob),
            1 => Some(Self::Record),
            2 => Some(Self::Memo),
            _ => None,
        }
    }

    pub(super) fn code(self) -> u8 {
        match self {
            Self::Blob => 0,
            Self::Record => 1,
            Self::Memo => 2,
        }
    }

    /// Its name in reports.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Blob => "blob",
            Self::Record => "record",
            Self::Memo => "memo",
        }
    }
}

fn seal_of(kind: Kind, id: &Digest, rest: &[u8]) -> Digest {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&[kind.code()]).update(id.as_bytes()).update(rest);
    Digest::from_bytes(*hasher.finalize().as_bytes())
}

/// Returns the payload of a record or memo.
pub(super) fn seal(kind: Kind, id: &Digest, generation: u32, content: &[u8]) -> Vec<u8> {
    let rest = [&generation.to_le_bytes(), content].concat();
    [seal_of(kind, id, &rest).as_bytes(), rest.as_slice()].concat()
}

/// Returns the content of a payload that is what its entry says; none if it is damaged.
pub(super) fn open<'a>(kind: Kind, id: &Digest, payload: &'a [u8]) -> Option<&'a [u8]> {
    if kind == Kind::Blob {
        return (Digest::of(payload) == *id).then_some(payload);
    }
    let (checksum, rest) = payload.split_at_checked(DIGEST)?;
    let whole = seal_of(kind, id, rest).as_bytes() == checksum;
    whole.then(|| payload.get(SEALED_HEAD..)).flatten()
}

fn generation_of(kind: Kind, payload: &[u8]) -> u32 {
    match kind {
        Kind::Blob => 0,
        _ => read::u32_at(payload, DIGEST).unwrap_or(0),
    }
}

/// Writes a pack in chunks to a temporary file.
pub(super) struct Writer<'a> {
    files: &'a Files,
    path: &'a Path,
    buffer: Vec<u8>,
    written: u64,
    entries: Vec<Entry>,
}

impl<'a> Writer<'a> {
    pub(super) fn new(files: &'a Files, path: &'a Path) -> Self {
        Self {
            files,
            path,
            buffer: MAGIC.to_vec(),
            written: 0,
            entries: Vec::new(),
        }
    }

    /// Returns the offset of the next byte.
    pub(super) fn at(&self) -> u64 {
        self.written + self.buffer.len() as u64
    }

    pub(super) fn add(&mut self, kind: Kind, id: &Digest, payload: &[u8]) -> Result<(), StoreError> {
        // Payloads of packs are far below 4 GiB.
        let len = payload.len() as u32;
        self.buffer.push(kind.code());
        self.buffer.extend_from_slice(id.as_bytes());
        self.buffer.extend_from_slice(&len.to_le_bytes());
        self.entries.push(Entry {
            kind,
            id: *id,
            offset: self.at(),
            len,
            generation: generation_of(kind, payload),
        });
        self.buffer.extend_from_slice(payload);
        self.flush_from(CHUNK)
    }

    fn flush_from(&mut self, least: usize) -> Result<(), StoreError> {
        if self.buffer.len() < least {
            return Ok(());
        }
        self.files.append(self.path, &self.buffer)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Writes the table; returns the entries.
    pub(super) fn finish(mut self) -> Result<Vec<Entry>, StoreError> {
        let offset = self.at();
        let mut table = Vec::with_capacity(self.entries.len() * ROW + TAIL);
        for entry in &self.entries {
            table.push(entry.kind.code());
            table.extend_from_slice(entry.id.as_bytes());
            table.extend_from_slice(&entry.offset.to_le_bytes());
            table.extend_from_slice(&entry.len.to_le_bytes());
            table.extend_from_slice(&entry.generation.to_le_bytes());
        }
        table.extend_from_slice(&offset.to_le_bytes());
        let checksum = Digest::of(&table);
        table.extend_from_slice(checksum.as_bytes());
        table.extend_from_slice(END);
        self.buffer.extend_from_slice(&table);
        self.flush_from(0)?;
        self.files.seal(self.path)?;
        Ok(self.entries)
    }
}

/// A pack whose body is the bodies of other packs, one behind the other.
pub(super) struct Joined<'a> {
    writer: Writer<'a>,
}

impl<'a> Joined<'a> {
    pub(super) fn new(files: &'a Files, path: &'a Path) -> Self {
        Self {
            writer: Writer::new(files, path),
        }
    }

    /// Appends the body of a pack; returns how far its entries moved, or none, with nothing appended but dead bytes,
    /// if an entry is damaged.
    pub(super) fn append(
        &mut self,
        files: &Files,
        pack: &Path,
        contents: &Contents,
    ) -> Result<Option<u64>, StoreError> {
        let moved = self.writer.at() - BODY;
        let first = self.writer.entries.len();
        let mut window = Window::new(files, pack);
        let mut expected = BODY;
        for entry in &contents.entries {
            let payload = window.payload(entry)?;
            let is_whole = open(entry.kind, &entry.id, payload).is_some();
            if !is_whole || entry.offset != expected + HEAD as u64 {
                self.writer.entries.truncate(first);
                return Ok(None);
            }
            self.writer.add(entry.kind, &entry.id, payload)?;
            expected = entry.offset + u64::from(entry.len);
        }
        Ok(Some(moved))
    }

    pub(super) fn finish(self) -> Result<Vec<Entry>, StoreError> {
        self.writer.finish()
    }
}
