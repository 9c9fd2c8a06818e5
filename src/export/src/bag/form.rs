//! Names and digests of the files of a bag.

use std::io;

use marf_cache::file::Stoppable;
use marf_cache::{Digest, Sha256, Sha256Reader};
use marf_engine::Cancel;

/// Folder of the payload.
pub const PAYLOAD: &str = "data";
/// The declaration that makes a folder a bag.
pub(super) const DECLARATION: &str = "bagit.txt";
pub(super) const DECLARATION_TEXT: &str = "BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n";
/// Facts about the bag.
pub(super) const INFO: &str = "bag-info.txt";
/// Digests of the payload.
pub const MANIFEST: &str = "manifest-sha256.txt";
/// Digests of the other files.
pub(super) const TAG_MANIFEST: &str = "tagmanifest-sha256.txt";

/// Length and digests of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileDigest {
    /// Length in bytes.
    pub bytes: u64,
    /// The digest by which bags and signatures know it.
    pub sha256: Sha256,
    /// The digest by which the store knows it.
    pub blake3: Digest,
}

impl FileDigest {
    /// Returns length and digests of these bytes.
    pub fn new(bytes: &[u8]) -> Self {
        Self {
            bytes: bytes.len() as u64,
            sha256: Sha256::from_content(bytes),
            blake3: Digest::from_content(bytes),
        }
    }

    /// Returns length and digests of all that a reader gives, without holding it.
    ///
    /// # Errors
    /// A reader that fails. The wish of the user to stop.
    pub fn from_reader(reader: impl io::Read, cancel: &Cancel) -> io::Result<Self> {
        let mut reader = Sha256Reader::new(Stoppable::new(reader, || cancel.is_set()));
        let (blake3, bytes) = Digest::from_reader(&mut reader)?;
        Ok(Self {
            bytes,
            sha256: reader.finish(),
            blake3,
        })
    }
}
