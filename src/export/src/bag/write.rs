//! Writing a bag, file by file.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::form::{DECLARATION, DECLARATION_TEXT, FileDigest, INFO, MANIFEST, PAYLOAD, TAG_MANIFEST};
use super::path::{encode_path, is_safe};

/// A bag that is being written. The same files give the same bag to the byte, in whatever order they come.
#[derive(Debug)]
pub struct BagWriter {
    folder: PathBuf,
    payload: BTreeMap<String, FileDigest>,
    tags: BTreeMap<String, FileDigest>,
}

impl BagWriter {
    /// Begins a bag in a new folder.
    ///
    /// # Errors
    /// A folder that is there already or cannot be made.
    pub fn create(folder: &Path) -> io::Result<Self> {
        fs::create_dir(folder)?;
        let mut bag = Self {
            folder: folder.to_owned(),
            payload: BTreeMap::new(),
            tags: BTreeMap::new(),
        };
        bag.tag(DECLARATION, DECLARATION_TEXT.as_bytes())?;
        Ok(bag)
    }

    /// Adds a file to the payload.
    ///
    /// # Errors
    /// A path that leads out of the bag or is taken, or a file that cannot be written.
    pub fn add(&mut self, path: &str, bytes: &[u8]) -> io::Result<FileDigest> {
        if !is_safe(path) || self.payload.contains_key(path) {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                format!("`{path}` cannot be a file of a bag, or is there twice"),
            ));
        }
        let digest = self.write(&format!("{PAYLOAD}/{path}"), bytes)?;
        self.payload.insert(path.to_owned(), digest);
        Ok(digest)
    }

    /// Returns the number of files of the payload and their bytes.
    pub fn payload_size(&self) -> (u64, u64) {
        let bytes = self.payload.values().map(|digest| digest.bytes).sum();
        (self.payload.len() as u64, bytes)
    }

    /// Writes the manifest of the payload and returns its bytes. Nothing is added to the payload afterwards.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn seal(&mut self) -> io::Result<FileDigest> {
        let lines = self.payload.iter().map(|(path, digest)| {
            let path = encode_path(path);
            format!("{}  {PAYLOAD}/{path}\n", digest.sha256)
        });
        let text: String = lines.collect();
        self.tag(MANIFEST, text.as_bytes())
    }

    /// Adds a file next to the payload.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn tag(&mut self, name: &str, bytes: &[u8]) -> io::Result<FileDigest> {
        let digest = self.write(name, bytes)?;
        self.tags.insert(name.to_owned(), digest);
        Ok(digest)
    }

    /// Writes the facts of the bag, and the manifest of the files next to the payload.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish(mut self, info: &[(&str, String)]) -> io::Result<()> {
        let (files, bytes) = self.payload_size();
        let oxum = format!("Payload-Oxum: {bytes}.{files}\n");
        let lines = info.iter().map(|(label, value)| format!("{label}: {value}\n"));
        let text: String = lines.chain([oxum]).collect();
        self.tag(INFO, text.as_bytes())?;
        let tags = self.tags.iter();
        let lines: String = tags
            .map(|(name, digest)| format!("{}  {}\n", digest.sha256, encode_path(name)))
            .collect();
        self.write(TAG_MANIFEST, lines.as_bytes()).map(drop)
    }

    fn write(&self, path: &str, bytes: &[u8]) -> io::Result<FileDigest> {
        let whole = self.folder.join(path);
        if let Some(folder) = whole.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(whole, bytes)?;
        Ok(FileDigest::new(bytes))
    }
}
