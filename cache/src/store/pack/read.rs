//! Reading of packs: their tables, and their entries one by one.

use std::path::Path;

use super::format::{
    BODY, CHUNK, Contents, DIGEST, END, Entry, HEAD, Kind, MAGIC, ROW, TAIL, digest_at, generation_of, open,
    u32_at, u64_at,
};
use crate::{
    Digest,
    store::{error::StoreError, files::Files},
};

/// Returns the entries of a pack, from its table or, without a valid one, by a scan that verifies each. Returns
/// `None` if the file is absent. A file that is not a pack has no entries.
pub(in crate::store) fn contents(files: &Files, path: &Path) -> Result<Option<Contents>, StoreError> {
    if files.read_at(path, 0, MAGIC.len())?.is_none() {
        return Ok(None);
    }
    if let Some(entries) = table(files, path)? {
        return Ok(Some(Contents {
            entries,
            has_table: true,
        }));
    }
    let mut window = Window::new(files, path);
    let mut entries = Vec::new();
    let mut at = BODY;
    while let Some((entry, payload)) = window.entry_at(at)? {
        if open(entry.kind, &entry.id, payload).is_some() {
            entries.push(entry);
        }
        at = entry.offset + u64::from(entry.len);
    }
    // A pack that was removed while it was read is gone, not damaged: another program has merged it. No pack gets its name.
    let contents = Contents {
        entries,
        has_table: false,
    };
    Ok(files.exists(path)?.then_some(contents))
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
    if tail.get(8..8 + DIGEST) != Some(Digest::from_content(&rows).as_bytes()) {
        return Ok(None);
    }
    let rows = rows.chunks_exact(ROW).map(|row| {
        Some(Entry {
            kind: Kind::from_code(*row.first()?)?,
            id: digest_at(row, 1)?,
            offset: u64_at(row, 33)?,
            len: u32_at(row, 41)?,
            generation: u32_at(row, 45)?,
        })
    });
    Ok(rows.collect())
}

/// A part of a pack in memory, so that entries are read in order without a call for each.
pub(in crate::store) struct Window<'a> {
    files: &'a Files,
    path: &'a Path,
    start: u64,
    bytes: Vec<u8>,
}

impl<'a> Window<'a> {
    pub(in crate::store) fn new(files: &'a Files, path: &'a Path) -> Self {
        Self {
            files,
            path,
            start: 0,
            bytes: Vec::new(),
        }
    }

    /// Returns bytes of the pack, or fewer at its end.
    pub(in crate::store) fn bytes(&mut self, at: u64, len: usize) -> Result<&[u8], StoreError> {
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

    /// Returns the entry whose head is at this offset, or `None` at the end of the body or if the head is
    /// damaged.
    fn entry_at(&mut self, at: u64) -> Result<Option<(Entry, &[u8])>, StoreError> {
        let head = self.bytes(at, HEAD)?;
        let kind = head.first().copied().and_then(Kind::from_code);
        let (Some(kind), Some(id), Some(len)) = (kind, digest_at(head, 1), u32_at(head, 1 + DIGEST)) else {
            return Ok(None);
        };
        let offset = at + HEAD as u64;
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
    pub(in crate::store) fn payload(&mut self, entry: &Entry) -> Result<&[u8], StoreError> {
        self.bytes(entry.offset, entry.len as usize)
    }

    /// Returns whether the head before a payload agrees with its entry.
    pub(in crate::store) fn has_head(&mut self, entry: &Entry) -> Result<bool, StoreError> {
        let expected = head_of(entry);
        let Some(at) = entry.offset.checked_sub(expected.len() as u64) else {
            return Ok(false);
        };
        Ok(self.bytes(at, expected.len())? == expected)
    }
}

fn head_of(entry: &Entry) -> Vec<u8> {
    let mut head = vec![entry.kind.code()];
    head.extend_from_slice(entry.id.as_bytes());
    head.extend_from_slice(&entry.len.to_le_bytes());
    head
}

/// Returns whether the head before a payload in a pack agrees with its entry.
pub(in crate::store) fn has_head(files: &Files, path: &Path, entry: &Entry) -> Result<bool, StoreError> {
    let expected = head_of(entry);
    let Some(at) = entry.offset.checked_sub(expected.len() as u64) else {
        return Ok(false);
    };
    Ok(files.read_at(path, at, expected.len())? == Some(expected))
}
