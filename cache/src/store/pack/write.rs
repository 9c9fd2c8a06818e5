//! Writing of packs: a new one, or one from the bodies of others.

use std::path::Path;

use super::{
    format::{BODY, CHUNK, Contents, END, Entry, HEAD, Kind, MAGIC, ROW, TAIL, generation_of, open},
    read::Window,
};
use crate::{
    Digest,
    store::{error::StoreError, files::Files},
};

/// Writes a pack in chunks to a temporary file.
pub(in crate::store) struct Writer<'a> {
    files: &'a Files,
    path: &'a Path,
    buffer: Vec<u8>,
    written: u64,
    entries: Vec<Entry>,
}

impl<'a> Writer<'a> {
    pub(in crate::store) fn new(files: &'a Files, path: &'a Path) -> Self {
        Self {
            files,
            path,
            buffer: MAGIC.to_vec(),
            written: 0,
            entries: Vec::new(),
        }
    }

    /// Returns the offset of the next byte.
    pub(in crate::store) fn at(&self) -> u64 {
        self.written + self.buffer.len() as u64
    }

    pub(in crate::store) fn add(
        &mut self,
        kind: Kind,
        id: &Digest,
        payload: &[u8],
    ) -> Result<(), StoreError> {
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

    /// Writes the table and returns the entries.
    pub(in crate::store) fn finish(mut self) -> Result<Vec<Entry>, StoreError> {
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
        let checksum = Digest::from_content(&table);
        table.extend_from_slice(checksum.as_bytes());
        table.extend_from_slice(END);
        self.buffer.extend_from_slice(&table);
        self.flush_from(0)?;
        self.files.seal(self.path)?;
        Ok(self.entries)
    }
}

/// Writes a pack whose body is the bodies of other packs, one behind the other.
pub(in crate::store) struct PackJoiner<'a> {
    writer: Writer<'a>,
}

impl<'a> PackJoiner<'a> {
    pub(in crate::store) fn new(files: &'a Files, path: &'a Path) -> Self {
        Self {
            writer: Writer::new(files, path),
        }
    }

    /// Appends the body of a pack and returns how far its entries moved. If an entry is damaged, returns `None` and
    /// has appended only dead bytes.
    pub(in crate::store) fn append(
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

    pub(in crate::store) fn finish(self) -> Result<Vec<Entry>, StoreError> {
        self.writer.finish()
    }
}
