//! An unfinished body: in memory, and in a part on disk from which a later run goes on.
//!
//! The sidecar `PART.json` of `PART` holds the address, its validators, the length, the number of good bytes and
//! their blake3. Only bytes with the sidecar's digest are taken from a part, so neither file needs a sync: bytes that
//! a crash spoils do not verify and are fetched again. A part that another process holds is left to it.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_cache::file::{Links, read_within};
use serde::{Deserialize, Serialize};

use super::error::NetErrorKind;
use super::{Url, Validators, range};
use crate::files::{self, beside};

/// Bytes after which the sidecar is written again.
const CHECKPOINT_BYTES: u64 = 1 << 20;
/// Bytes before the end of a part that are fetched again and compared, at most half of it: some hosts give other bytes under
/// an equal `ETag`.
const COMPARED_BYTES: u64 = 64 << 10;
/// Largest buffer that is reserved for an announced length, before any byte has come.
const MOST_RESERVED: u64 = 8 << 20;
/// Largest sidecar that is read.
const MAX_SIDECAR_BYTES: u64 = 64 << 10;

/// What the head of an answer says of the body.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Head {
    /// The address that was asked.
    pub asked: String,
    /// The address that answered, after redirects.
    pub url: String,
    /// What it said of the version.
    pub validators: Validators,
    /// Bytes of the whole, if announced.
    pub length: Option<u64>,
}

#[derive(Serialize, Deserialize)]
struct Sidecar {
    head: Head,
    bytes: u64,
    blake3: Digest,
    complete: bool,
}

/// The bytes of a body that have come.
#[derive(Debug)]
pub(super) struct Body {
    pub head: Head,
    bytes: Vec<u8>,
    /// Where the next byte belongs: before the end while bytes are compared.
    at: usize,
    hasher: blake3::Hasher,
}

impl Body {
    /// Bytes so far.
    pub(super) fn len(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Where the rest begins that is requested.
    pub(super) fn rest_from(&self) -> u64 {
        self.len() - COMPARED_BYTES.min(self.len().div_ceil(2))
    }
}

/// The body of one download, and its part.
#[derive(Debug)]
pub(super) struct PartialDownload {
    cap: u64,
    part: Option<(PathBuf, File)>,
    body: Option<Body>,
    /// Bytes that the sidecar has the digest of.
    saved: u64,
    complete: bool,
}

impl PartialDownload {
    /// Opens the part of an earlier try or run. Bytes that do not verify are dropped.
    ///
    /// # Errors
    /// A part that cannot be opened or read.
    pub(super) fn open(part: Option<&Path>, cap: u64) -> Result<Self, NetErrorKind> {
        let mut partial = Self {
            cap,
            part: None,
            body: None,
            saved: 0,
            complete: false,
        };
        let Some(path) = part else {
            return Ok(partial);
        };
        let mut file = opened(path).map_err(|error| in_part(path, &error))?;
        match file.try_lock() {
            Ok(()) => {}
            // Another process fetches the same file. Ours stays in memory.
            Err(fs::TryLockError::WouldBlock) => return Ok(partial),
            Err(fs::TryLockError::Error(error)) => return Err(in_part(path, &error)),
        }
        if let Some((body, complete)) = left_behind(path, &mut file, cap) {
            (partial.saved, partial.complete) = (body.len(), complete);
            partial.body = Some(body);
        }
        file.set_len(partial.saved)
            .and_then(|()| file.seek(SeekFrom::End(0)))
            .map_err(|error| in_part(path, &error))?;
        partial.part = Some((path.to_owned(), file));
        Ok(partial)
    }

    /// Returns the body so far, if any.
    pub(super) fn body(&self) -> Option<&Body> {
        self.body.as_ref()
    }

    /// Whether the body is complete.
    pub(super) fn is_complete(&self) -> bool {
        self.complete
    }

    /// Returns the body that can be continued from this address, and the value for `If-Range`.
    pub(super) fn continues(&self, asked: &Url, url: &Url) -> Option<(&Body, &str)> {
        let body = self.body.as_ref()?;
        let same = body.head.asked == asked.as_str() && body.head.url == url.as_str();
        let value = range::if_range(&body.head.validators)?;
        (same && body.len() > 0 && !self.complete).then_some((body, value))
    }

    /// Drops what has come and begins a new body.
    ///
    /// # Errors
    /// A part that cannot be written.
    pub(super) fn restart(&mut self, head: Head) -> Result<(), NetErrorKind> {
        self.discard()?;
        self.body = Some(Body {
            head,
            bytes: Vec::new(),
            at: 0,
            hasher: blake3::Hasher::new(),
        });
        Ok(())
    }

    /// Drops what has come.
    ///
    /// # Errors
    /// A part that cannot be written.
    pub(super) fn discard(&mut self) -> Result<(), NetErrorKind> {
        (self.body, self.saved, self.complete) = (None, 0, false);
        let Some((path, file)) = &mut self.part else {
            return Ok(());
        };
        remove(&sidecar(path));
        file.set_len(0)
            .and_then(|()| file.rewind())
            .map_err(|error| in_part(path, &error))
    }

    /// Drops what came from an address that has nothing to continue.
    ///
    /// # Errors
    /// A part that cannot be written.
    pub(super) fn gone(&mut self, asked: &Url) -> Result<(), NetErrorKind> {
        match &self.body {
            Some(body) if body.head.asked == asked.as_str() => self.discard(),
            _ => Ok(()),
        }
    }

    /// Refuses a body that is announced as too large, and reserves memory for one that is not.
    ///
    /// # Errors
    /// More than the cap.
    pub(super) fn announced(&mut self) -> Result<(), NetErrorKind> {
        let (cap, body) = (self.cap, self.body.as_mut().ok_or(NetErrorKind::Lost)?);
        let bytes = body.head.length.unwrap_or(0);
        if bytes > cap {
            return Err(NetErrorKind::TooLarge { bytes, cap });
        }
        let reserved = bytes.saturating_sub(body.len()).min(MOST_RESERVED);
        body.bytes.reserve(reserved as usize);
        Ok(())
    }

    /// Expects the rest of a whole of this length.
    pub(super) fn resume(&mut self, length: u64) {
        if let Some(body) = &mut self.body {
            body.head.length = Some(length);
            body.at = body.rest_from() as usize;
        }
    }

    /// Adds bytes that came.
    ///
    /// # Errors
    /// More than the cap, other bytes than the kept ones, or a part that cannot be written.
    pub(super) fn push(&mut self, chunk: &[u8]) -> Result<(), NetErrorKind> {
        let body = self.body.as_mut().ok_or(NetErrorKind::Lost)?;
        let (again, chunk) = chunk.split_at(chunk.len().min(body.bytes.len() - body.at));
        if !body.bytes[body.at..].starts_with(again) {
            return Err(NetErrorKind::Rest("it has other bytes".into()));
        }
        let bytes = body.len() + chunk.len() as u64;
        if bytes > self.cap {
            return Err(NetErrorKind::TooLarge { bytes, cap: self.cap });
        }
        body.bytes.extend_from_slice(chunk);
        body.at += again.len() + chunk.len();
        body.hasher.update(chunk);
        if let Some((path, file)) = &mut self.part {
            file.write_all(chunk).map_err(|error| in_part(path, &error))?;
        }
        if bytes - self.saved >= CHECKPOINT_BYTES {
            self.checkpoint()?;
        }
        Ok(())
    }

    /// Ends the body and returns its bytes, if they are as many as announced.
    ///
    /// # Errors
    /// Another length, or a part that cannot be written.
    pub(super) fn finish(&mut self) -> Result<(Head, Vec<u8>), NetErrorKind> {
        let body = self.body.as_mut().ok_or(NetErrorKind::Lost)?;
        let came = body.at as u64;
        if let Some(announced) = body.head.length.filter(|announced| *announced != came) {
            return Err(NetErrorKind::Length { announced, came });
        }
        body.head.length = Some(came);
        self.complete = true;
        self.checkpoint()?;
        self.taken().ok_or(NetErrorKind::Lost)
    }

    /// Takes the body out. The part stays as it is.
    pub(super) fn taken(&mut self) -> Option<(Head, Vec<u8>)> {
        let body = self.body.take()?;
        Some((body.head, body.bytes))
    }

    /// Ends a failed try: keeps what can be continued, drops the rest.
    ///
    /// # Errors
    /// A part that cannot be written.
    pub(super) fn settle(&mut self) -> Result<(), NetErrorKind> {
        let usable = |body: &Body| {
            let within = body.head.length.is_none_or(|length| body.len() < length);
            body.len() > 0 && within && range::if_range(&body.head.validators).is_some()
        };
        match &self.body {
            Some(body) if !usable(body) => self.discard(),
            Some(_) => self.checkpoint(),
            None => Ok(()),
        }
    }

    /// Writes the sidecar of all that has come.
    fn checkpoint(&mut self) -> Result<(), NetErrorKind> {
        let (Some((path, _)), Some(body)) = (&self.part, &self.body) else {
            return Ok(());
        };
        let text = serde_json::to_vec(&Sidecar {
            head: body.head.clone(),
            bytes: body.len(),
            blake3: Digest::from_bytes(*body.hasher.finalize().as_bytes()),
            complete: self.complete,
        });
        let written = text
            .map_err(std::io::Error::other)
            .and_then(|text| files::replace(&sidecar(path), &text));
        written.map_err(|error| in_part(path, &error))?;
        self.saved = body.len();
        Ok(())
    }
}

/// An unfinished download keeps the bytes received so far. If that fails, it costs only time.
impl Drop for PartialDownload {
    fn drop(&mut self) {
        if !self.complete {
            let _ = self.settle();
        }
        let empty = self.body.is_none() && !self.complete;
        if let (true, Some((path, _))) = (empty, &self.part) {
            forget(path);
        }
    }
}

/// Deletes a part and its sidecar. A part that cannot be deleted stays, and is never read without its sidecar.
pub(crate) fn forget(part: &Path) {
    [&sidecar(part), &beside(part, ".json.new"), part]
        .iter()
        .for_each(|path| remove(path));
}

fn remove(path: &Path) {
    // Nothing there, or it stays: see `forget`.
    let _ = fs::remove_file(path);
}

fn sidecar(part: &Path) -> PathBuf {
    beside(part, ".json")
}

fn opened(path: &Path) -> std::io::Result<File> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)
}

/// Reads the bytes that the sidecar has the digest of, if they verify.
fn left_behind(path: &Path, file: &mut File, cap: u64) -> Option<(Body, bool)> {
    let text = read_within(&sidecar(path), MAX_SIDECAR_BYTES, Links::Followed).ok()?;
    let sidecar: Sidecar = serde_json::from_slice(&text).ok()?;
    let whole = sidecar.head.length == Some(sidecar.bytes);
    let there = file.metadata().ok()?.len();
    if sidecar.bytes > cap.min(there) || sidecar.complete != whole {
        return None;
    }
    let mut bytes = Vec::new();
    io::copy(&mut file.take(sidecar.bytes), &mut bytes).ok()?;
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes);
    let verified = hasher.finalize().as_bytes() == sidecar.blake3.as_bytes();
    let body = Body {
        head: sidecar.head,
        at: bytes.len(),
        bytes,
        hasher,
    };
    (verified && body.len() == sidecar.bytes).then_some((body, sidecar.complete))
}

fn in_part(path: &Path, error: &std::io::Error) -> NetErrorKind {
    NetErrorKind::Part {
        path: path.to_owned(),
        error: error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAP: u64 = 8 << 20;

    fn head() -> Head {
        Head {
            asked: "https://a.example/x".to_owned(),
            url: "https://b.example/x".to_owned(),
            validators: Validators {
                etag: Some("\"1\"".to_owned()),
                modified: None,
            },
            length: Some(4 << 20),
        }
    }

    /// As after a kill: the files are copied while the download is under way.
    #[test]
    fn a_killed_download_keeps_all_but_the_last_megabyte() {
        let folder = tempfile::tempdir().unwrap();
        let (live, dead) = (folder.path().join("live"), folder.path().join("dead"));
        let mut partial = PartialDownload::open(Some(&live), CAP).unwrap();
        partial.restart(head()).unwrap();
        for step in 0..50_u8 {
            partial.push(&[step; 65_536]).unwrap();
        }
        fs::copy(&live, &dead).unwrap();
        fs::copy(sidecar(&live), sidecar(&dead)).unwrap();
        let back = PartialDownload::open(Some(&dead), CAP).unwrap();
        let body = back.body().unwrap();
        assert_eq!((body.len(), &body.head), (3 << 20, &head()));
        assert_eq!(body.bytes[body.bytes.len() - 1], 47);
        let small = PartialDownload::open(Some(&dead), CAP);
        assert!(small.unwrap().body().is_none(), "held by `back`");
        drop(back);
        assert!(
            PartialDownload::open(Some(&dead), 1_000)
                .unwrap()
                .body()
                .is_none(),
            "past the cap"
        );
    }

    #[test]
    fn an_announced_length_reserves_no_more_than_the_cap() {
        let mut partial = PartialDownload::open(None, 1_000).unwrap();
        partial.restart(head()).unwrap();
        let refused = partial.announced();
        assert_eq!(
            refused,
            Err(NetErrorKind::TooLarge {
                bytes: 4 << 20,
                cap: 1_000
            })
        );
        let mut partial = PartialDownload::open(None, u64::MAX).unwrap();
        let endless = Head {
            length: Some(u64::MAX),
            ..head()
        };
        partial.restart(endless).unwrap();
        partial.announced().unwrap();
        assert!(partial.body.as_ref().unwrap().bytes.capacity() as u64 <= 2 * MOST_RESERVED);
    }
}
