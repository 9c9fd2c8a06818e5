//! Reading a bag: every file against the manifests, strictly.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use marf_cache::Sha256;
use marf_cache::file::{self, FileKind, Links};
use marf_engine::Cancel;

use super::form::{DECLARATION, DECLARATION_TEXT, FileDigest, INFO, MANIFEST, PAYLOAD, TAG_MANIFEST};
use super::path::{decode_path, is_safe};

/// A bag as it is found.
#[derive(Debug)]
pub struct Bag {
    folder: PathBuf,
    cancel: Cancel,
    /// Length and digests of the files of the payload that are listed and there, by their paths in it.
    pub payload: BTreeMap<String, FileDigest>,
    /// All that is wrong with it.
    pub faults: Vec<BagFault>,
}

/// Entries of a manifest.
type Listed = BTreeMap<String, Sha256>;

/// Something wrong with a bag. `file` is a path in it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum BagFault {
    /// A file that must be there is not, or cannot be read.
    #[error("`{file}` is missing or cannot be read: {cause}")]
    Unreadable {
        /// The file.
        file: String,
        /// The error of the operating system.
        cause: String,
    },
    /// A file with other bytes than listed.
    #[error("`{file}` was altered: SHA-256 {found}, listed as {listed}")]
    Altered {
        /// The file.
        file: String,
        /// Its digest.
        found: Sha256,
        /// The digest that the manifest lists.
        listed: Sha256,
    },
    /// A file that no manifest lists.
    #[error("`{file}` is in no manifest")]
    Unlisted {
        /// The file.
        file: String,
    },
    /// A file that the manifest of the payload lists and that is not in the payload.
    #[error("`manifest-sha256.txt` lists `{file}`, which is not in the payload")]
    NotPayload {
        /// The file.
        file: String,
    },
    /// A malformed line of a manifest, or one that names a file twice or out of the bag.
    #[error("line {line} of `{file}` is not a digest and path of a file in the bag")]
    BadLine {
        /// The manifest.
        file: String,
        /// Its line, from 1.
        line: usize,
    },
    /// `bagit.txt` says something else than version 1.0 in UTF-8.
    #[error("`bagit.txt` does not declare a bag of version 1.0")]
    Declaration,
    /// `bag-info.txt` counts other files or bytes.
    #[error("`bag-info.txt` lists {listed}, but the payload has {found}")]
    Oxum {
        /// The files and bytes found, in words.
        found: String,
        /// Those listed, in words.
        listed: String,
    },
}

impl Bag {
    /// Reads every file of a bag once and compares it with the manifests. If the user wants to stop, the files that are not read by
    /// then are faults.
    pub fn read(folder: &Path, cancel: &Cancel) -> Self {
        let mut bag = Self {
            folder: folder.to_owned(),
            cancel: cancel.clone(),
            payload: BTreeMap::new(),
            faults: Vec::new(),
        };
        let tags = bag.manifest(TAG_MANIFEST);
        let payload = bag.manifest(MANIFEST);
        bag.check_tags(&tags);
        bag.check_payload(&payload);
        bag.check_unlisted(|file| tags.contains_key(file) || payload.contains_key(file));
        bag.check_oxum();
        bag.faults.sort();
        bag
    }

    /// Returns the bytes of a file of the payload.
    ///
    /// # Errors
    /// A file that cannot be read. The wish of the user to stop.
    pub fn get(&self, path: &str) -> io::Result<Vec<u8>> {
        if self.cancel.is_set() {
            return Err(io::Error::other("stopped"));
        }
        read_member(&self.folder, &format!("{PAYLOAD}/{path}"))
    }

    /// Returns the bytes of a file next to the payload. `None` if it cannot be read.
    pub fn tag(&self, name: &str) -> Option<Vec<u8>> {
        read_member(&self.folder, name).ok()
    }

    fn check_tags(&mut self, tags: &Listed) {
        for (file, listed) in tags {
            self.compare(file, listed);
        }
        match self.or_fault(DECLARATION, read_member(&self.folder, DECLARATION)) {
            Some(bytes) if bytes != DECLARATION_TEXT.as_bytes() => self.faults.push(BagFault::Declaration),
            _ => {}
        }
    }

    fn check_payload(&mut self, payload: &Listed) {
        for (file, listed) in payload {
            let Some(path) = file.strip_prefix(PAYLOAD).and_then(|path| path.strip_prefix('/')) else {
                self.faults.push(BagFault::NotPayload { file: file.clone() });
                continue;
            };
            if let Some(digest) = self.compare(file, listed) {
                self.payload.insert(path.to_owned(), digest);
            }
        }
    }

    /// Reads a file, compares it, and returns its digests if it could be read, altered or not.
    fn compare(&mut self, file: &str, listed: &Sha256) -> Option<FileDigest> {
        let member = file::below(&self.folder, file).and_then(|path| file::open(&path, Links::Refused));
        let digest = member.and_then(|member| FileDigest::from_reader(member, &self.cancel));
        let digest = self.or_fault(file, digest)?;
        if digest.sha256 != *listed {
            self.faults.push(BagFault::Altered {
                file: file.to_owned(),
                found: digest.sha256,
                listed: *listed,
            });
        }
        Some(digest)
    }

    fn or_fault<T>(&mut self, file: &str, read: io::Result<T>) -> Option<T> {
        match read {
            Ok(found) => Some(found),
            Err(error) => {
                self.faults.push(BagFault::Unreadable {
                    file: file.to_owned(),
                    cause: error.to_string(),
                });
                None
            }
        }
    }

    /// Returns the digests that a manifest lists, by file.
    fn manifest(&mut self, name: &str) -> Listed {
        let read = read_member(&self.folder, name);
        let bytes = self.or_fault(name, read).unwrap_or_default();
        let mut listed = Listed::new();
        let text = String::from_utf8_lossy(&bytes);
        for (line, text) in (1..).zip(text.lines()) {
            let fresh = manifest_line(text).filter(|(file, _)| !listed.contains_key(file));
            match fresh {
                Some((file, digest)) => drop(listed.insert(file, digest)),
                None => self.faults.push(BagFault::BadLine {
                    file: name.to_owned(),
                    line,
                }),
            }
        }
        listed
    }

    /// Finds files that no manifest lists.
    fn check_unlisted(&mut self, is_listed: impl Fn(&str) -> bool) {
        for entry in walkdir::WalkDir::new(&self.folder).sort_by_file_name() {
            match entry {
                Ok(entry) if entry.file_type().is_dir() => {}
                Ok(entry) => {
                    let below = entry.path().strip_prefix(&self.folder).unwrap_or(entry.path());
                    let file = below.to_string_lossy().replace('\\', "/");
                    if file != TAG_MANIFEST && !is_listed(&file) {
                        self.faults.push(BagFault::Unlisted { file });
                    }
                }
                Err(error) => self.faults.push(BagFault::Unreadable {
                    file: String::new(),
                    cause: error.to_string(),
                }),
            }
        }
    }

    fn check_oxum(&mut self) {
        let info = self.tag(INFO).unwrap_or_default();
        let text = String::from_utf8_lossy(&info);
        let listed = text.lines().find_map(|line| line.strip_prefix("Payload-Oxum: "));
        let bytes: u64 = self.payload.values().map(|digest| digest.bytes).sum();
        let found = format!("{bytes}.{}", self.payload.len());
        if listed != Some(found.as_str()) {
            let listed = listed.map_or_else(|| "no size of the payload".to_owned(), oxum_text);
            let found = oxum_text(&found);
            self.faults.push(BagFault::Oxum { found, listed });
        }
    }
}

/// Returns bytes and files, which a bag separates by a point, in words.
fn oxum_text(oxum: &str) -> String {
    let number = |text: &str| text.parse::<u64>().ok();
    match oxum
        .split_once('.')
        .map(|(bytes, files)| (number(bytes), number(files)))
    {
        Some((Some(bytes), Some(1))) => format!("1 file with {bytes} bytes"),
        Some((Some(bytes), Some(files))) => format!("{files} files with {bytes} bytes"),
        _ => format!("`{oxum}` instead of bytes and files"),
    }
}

/// Reads a file of a bag by its path in it.
///
/// # Errors
/// A file that is absent, no regular file, too large, or behind a link.
pub fn read_member(folder: &Path, file: &str) -> io::Result<Vec<u8>> {
    let path = file::below(folder, file)?;
    file::read(&path, FileKind::Document, Links::Refused)
}

/// Reads a line of a manifest: a digest in small letters, two spaces, the path of a file in the bag.
fn manifest_line(line: &str) -> Option<(String, Sha256)> {
    let (text, path) = line.split_once("  ")?;
    let digest: Sha256 = text.parse().ok()?;
    let path = decode_path(path);
    (is_safe(&path) && digest.to_string() == text).then_some((path, digest))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::bag::BagWriter;

    fn read(folder: &Path) -> Bag {
        Bag::read(folder, &Cancel::default())
    }

    /// A bag of two files in a new folder.
    fn bag() -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("bag");
        let mut bag = BagWriter::create(&folder).unwrap();
        bag.add("a.txt", b"one").unwrap();
        bag.add("sub/100% b\n.txt", b"two").unwrap();
        bag.seal().unwrap();
        bag.finish(&[("Source-Organization", "test".to_owned())]).unwrap();
        (dir, folder)
    }

    #[test]
    fn a_bag_is_read_as_it_was_written() {
        let (_dir, folder) = bag();
        let read = read(&folder);
        assert_eq!(read.faults, []);
        let paths: Vec<&str> = read.payload.keys().map(String::as_str).collect();
        assert_eq!(paths, ["a.txt", "sub/100% b\n.txt"]);
        assert_eq!(read.payload["a.txt"], FileDigest::new(b"one"));
        assert_eq!(read.get("a.txt").unwrap(), b"one");
        let info = fs::read_to_string(folder.join(INFO)).unwrap();
        assert_eq!(info, "Source-Organization: test\nPayload-Oxum: 6.2\n");
    }

    /// One bit of every byte of every file, manifests included.
    #[test]
    fn a_bit_that_is_flipped_anywhere_is_a_fault() {
        let (_dir, folder) = bag();
        let files = walkdir::WalkDir::new(&folder).into_iter().map(Result::unwrap);
        let files: Vec<PathBuf> = files
            .filter(|entry| entry.file_type().is_file())
            .map(|entry| entry.into_path())
            .collect();
        assert_eq!(files.len(), 6);
        for file in files {
            let whole = fs::read(&file).unwrap();
            for place in 0..whole.len() {
                let mut bytes = whole.clone();
                bytes[place] ^= 1 << (place % 8);
                fs::write(&file, &bytes).unwrap();
                let faults = read(&folder).faults;
                assert!(!faults.is_empty(), "{} byte {place}", file.display());
            }
            fs::write(&file, &whole).unwrap();
        }
        assert_eq!(read(&folder).faults, []);
    }

    #[test]
    fn files_that_came_or_went_are_named() {
        let (_dir, folder) = bag();
        fs::write(folder.join("data/new.txt"), b"x").unwrap();
        fs::write(folder.join("note.txt"), b"x").unwrap();
        fs::remove_file(folder.join("data/a.txt")).unwrap();
        let faults: Vec<String> = read(&folder).faults.iter().map(ToString::to_string).collect();
        let text = faults.join("\n");
        for expected in [
            "`data/a.txt` is missing",
            "`data/new.txt` is in no manifest",
            "`note.txt` is in no manifest",
            "`bag-info.txt` lists 2 files with 6 bytes, but the payload has 1 file with 3 bytes",
        ] {
            assert!(text.contains(expected), "{text}");
        }
        assert_eq!(faults.len(), 4, "{text}");
    }

    #[test]
    fn a_manifest_cannot_lead_out_of_the_bag() {
        let (dir, folder) = bag();
        fs::write(dir.path().join("secret"), b"one").unwrap();
        let line = format!("{}  data/../../secret\n", Sha256::from_content(b"one"));
        fs::write(folder.join(MANIFEST), line).unwrap();
        let faults = read(&folder).faults;
        assert!(
            faults.contains(&BagFault::BadLine {
                file: MANIFEST.to_owned(),
                line: 1
            }),
            "{faults:?}"
        );
    }

    /// Replaces each file by something else that has, or would have, its name.
    #[cfg(unix)]
    #[test]
    fn links_pipes_and_devices_are_faults_and_are_not_read() {
        let (dir, folder) = bag();
        let pipe = dir.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        let files = [
            "bagit.txt",
            "bag-info.txt",
            "manifest-sha256.txt",
            "tagmanifest-sha256.txt",
            "data/a.txt",
        ];
        for file in files {
            let (path, copy) = (folder.join(file), dir.path().join("copy"));
            fs::rename(&path, &copy).unwrap();
            for (target, expected) in [
                (&copy, "it is a link"),
                (&"/dev/zero".into(), "it is a link"),
                (&pipe, "it is a link"),
            ] {
                std::os::unix::fs::symlink(target, &path).unwrap();
                let faults = read(&folder).faults;
                let is_named = |fault: &BagFault| matches!(fault, BagFault::Unreadable { file: named, cause } if named == file && cause == expected);
                assert!(faults.iter().any(is_named), "{file}: {faults:?}");
                fs::remove_file(&path).unwrap();
            }
            fs::hard_link(&pipe, &path).unwrap();
            let faults = read(&folder).faults;
            let is_named = |fault: &BagFault| matches!(fault, BagFault::Unreadable { file: named, cause } if named == file && cause == "it is not a regular file");
            assert!(faults.iter().any(is_named), "{file}: {faults:?}");
            fs::remove_file(&path).unwrap();
            fs::rename(&copy, &path).unwrap();
        }
        let (inside, outside) = (folder.join("data/sub"), dir.path().join("sub"));
        fs::rename(&inside, &outside).unwrap();
        std::os::unix::fs::symlink(&outside, &inside).unwrap();
        let faults = read(&folder).faults;
        assert!(!faults.is_empty(), "a folder that is a link");
    }

    #[test]
    fn a_stop_ends_the_reading_of_a_file() {
        let (_dir, folder) = bag();
        let cancel = Cancel::default();
        let large = fs::File::create(folder.join("data/a.txt")).unwrap();
        large.set_len(1 << 40).unwrap();
        let asked = cancel.clone();
        let stop = std::thread::spawn(move || {
            std::thread::sleep(std::time::Duration::from_millis(100));
            asked.set();
        });
        let began = std::time::Instant::now();
        assert!(!Bag::read(&folder, &cancel).faults.is_empty());
        assert!(began.elapsed().as_secs() < 10, "{:?}", began.elapsed());
        stop.join().unwrap();
    }
}
