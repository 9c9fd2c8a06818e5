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

use std::path::Path;

use super::{error::StoreError, files::Files};
use crate::Digest;

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
        _ => u32_at(payload, DIGEST).unwrap_or(0),
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

fn array_at<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

fn digest_at(bytes: &[u8], at: usize) -> Option<Digest> {
    array_at(bytes, at).map(Digest::from_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    array_at(bytes, at).map(u32::from_le_bytes)
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    array_at(bytes, at).map(u64::from_le_bytes)
}

/// Returns the entries of a pack, from its table or, without a valid one, by a scan that verifies each; none if the
/// file is absent. A file that is no pack has no entries.
pub(super) fn contents(files: &Files, path: &Path) -> Result<Option<Contents>, StoreError> {
    let Some(magic) = files.read_at(path, 0, MAGIC.len())? else {
        return Ok(None);
    };
    let form = match magic == OLD_MAGIC {
        true => Form::Old,
        false => Form::Current,
    };
    let table = match form {
        Form::Old => old_table(files, path)?,
        Form::Current => table(files, path)?,
    };
    if let Some(entries) = table {
        return Ok(Some(Contents {
            form,
            entries,
            has_table: true,
        }));
    }
    let mut window = Window::new(files, path);
    let mut entries = Vec::new();
    let mut at = BODY;
    while let Some((entry, payload)) = window.entry_at(form, at)? {
        if open(entry.kind, &entry.id, payload).is_some() {
            entries.push(entry);
        }
        at = entry.offset + u64::from(entry.len);
    }
    Ok(Some(Contents {
        form,
        entries,
        has_table: false,
    }))
}

fn table(files: &Files, path: &Path) -> Result<Option<Vec<Entry>>, StoreError> {
    let bytes = files.meta(path).map_or(0, |meta| meta.bytes);
    let Some(tail_at) = bytes.checked_sub(TAIL as u64) else {
        return Ok(None);
    };
    let tail = files.read_at(path, tail_at, TAIL)?.unwrap_or_default();
    let Some(offset) = u64_at(&tail, 0).filter(|offset| tail.ends_with(END) && *offset <= tail_at) else {
        return Ok(None);
    };
    let rows = files
        .read_at(path, offset, (tail_at - offset) as usize + 8)?
        .unwrap_or_default();
    if tail.get(8..8 + DIGEST) != Some(Digest::of(&rows).as_bytes()) {
        return Ok(None);
    }
    let rows = rows.chunks_exact(ROW).map(|row| {
        Some(Entry {
            kind: Kind::of(*row.first()?)?,
            id: digest_at(row, 1)?,
            offset: u64_at(row, 33)?,
            len: u32_at(row, 41)?,
            generation: u32_at(row, 45)?,
        })
    });
    Ok(rows.collect())
}

fn old_table(files: &Files, path: &Path) -> Result<Option<Vec<Entry>>, StoreError> {
    let bytes = files.read(&path.with_extension("idx"))?.unwrap_or_default();
    Ok(decode_old_table(&bytes))
}

fn decode_old_table(bytes: &[u8]) -> Option<Vec<Entry>> {
    let (body, checksum) = bytes.split_at_checked(bytes.len().checked_sub(DIGEST)?)?;
    if Digest::of(body).as_bytes() != checksum {
        return None;
    }
    let rows = body.strip_prefix(OLD_INDEX.as_slice())?.chunks_exact(OLD_ROW);
    rows.map(|row| {
        Some(Entry {
            kind: Kind::Blob,
            id: digest_at(row, 0)?,
            offset: u64_at(row, DIGEST)?,
            len: u32_at(row, DIGEST + 8)?,
            generation: 0,
        })
    })
    .collect()
}

/// A part of a pack in memory, so that entries are read in order without a call for each.
pub(super) struct Window<'a> {
    files: &'a Files,
    path: &'a Path,
    start: u64,
    bytes: Vec<u8>,
}

impl<'a> Window<'a> {
    pub(super) fn new(files: &'a Files, path: &'a Path) -> Self {
        Self {
            files,
            path,
            start: 0,
            bytes: Vec::new(),
        }
    }

    /// Returns bytes of the pack; fewer at its end.
    pub(super) fn bytes(&mut self, at: u64, len: usize) -> Result<&[u8], StoreError> {
        let end = self.start + self.bytes.len() as u64;
        if at < self.start || at + len as u64 > end {
            let read = self.files.read_at(self.path, at, len.max(CHUNK))?;
            self.bytes = read.unwrap_or_default();
            self.start = at;
        }
        let from = ((at - self.start) as usize).min(self.bytes.len());
        let to = (from + len).min(self.bytes.len());
        Ok(self.bytes.get(from..to).unwrap_or_default())
    }

    /// Returns the entry whose head is at this offset; none at the end of the body or where the head is damaged.
    fn entry_at(&mut self, form: Form, at: u64) -> Result<Option<(Entry, &[u8])>, StoreError> {
        let head_len = match form {
            Form::Current => HEAD,
            Form::Old => OLD_HEAD,
        };
        let head = self.bytes(at, head_len)?;
        let start = head_len - OLD_HEAD;
        let kind = match form {
            Form::Current => head.first().copied().and_then(Kind::of),
            Form::Old => Some(Kind::Blob),
        };
        let (Some(kind), Some(id), Some(len)) = (kind, digest_at(head, start), u32_at(head, start + DIGEST))
        else {
            return Ok(None);
        };
        let offset = at + head_len as u64;
        // A damaged length must not make the reader ask for gigabytes.
        let room = self
            .files
            .meta(self.path)
            .map_or(0, |meta| meta.bytes.saturating_sub(offset));
        if u64::from(len) > room {
            return Ok(None);
        }
        let payload = self.bytes(offset, len as usize)?;
        let entry = Entry {
            kind,
            id,
            offset,
            len,
            generation: generation_of(kind, payload),
        };
        Ok(Some((entry, payload)))
    }

    /// Returns the payload of an entry.
    pub(super) fn payload(&mut self, entry: &Entry) -> Result<&[u8], StoreError> {
        self.bytes(entry.offset, entry.len as usize)
    }

    /// Tells whether the head before a payload says the same as its entry.
    pub(super) fn has_head(&mut self, form: Form, entry: &Entry) -> Result<bool, StoreError> {
        let expected = head_of(form, entry);
        let Some(at) = entry.offset.checked_sub(expected.len() as u64) else {
            return Ok(false);
        };
        Ok(self.bytes(at, expected.len())? == expected)
    }
}

fn head_of(form: Form, entry: &Entry) -> Vec<u8> {
    let mut head = match form {
        Form::Current => vec![entry.kind.code()],
        Form::Old => Vec::new(),
    };
    head.extend_from_slice(entry.id.as_bytes());
    head.extend_from_slice(&entry.len.to_le_bytes());
    head
}

/// Tells whether the head before a payload in a pack says the same as its entry.
pub(super) fn has_head(files: &Files, path: &Path, form: Form, entry: &Entry) -> Result<bool, StoreError> {
    let expected = head_of(form, entry);
    let Some(at) = entry.offset.checked_sub(expected.len() as u64) else {
        return Ok(false);
    };
    Ok(files.read_at(path, at, expected.len())? == Some(expected))
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
