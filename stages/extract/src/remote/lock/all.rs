//! All products that a marf.lock pins, of all archives. A collection must keep them.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use marf_cache::file::{Links, read_within};
use marf_cache::{Digest, Sha256};

use super::folder::{MAX_BYTES, in_utf8};
use super::{BadLine, Pin, WITH_LISTING, text};

/// A lock that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}{}: {cause}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
pub struct UnreadableLock {
    path: PathBuf,
    line: Option<usize>,
    cause: String,
}

/// A product as a lock pins it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PinnedProduct {
    /// The sol that it was listed under.
    pub sol: u32,
    /// Name of the file.
    pub name: String,
    /// Length, bytes.
    pub bytes: u64,
    /// Digest of the bytes.
    pub blake3: Digest,
    /// The digest by which others know them.
    pub sha256: Sha256,
    /// The address that served it. `None` if it came with the listing.
    pub url: Option<String>,
    /// The time, as `YYYY-MM-DDTHH:MM:SSZ`.
    pub fetched: String,
    /// Other bytes that the archive gave under the same name later.
    pub others: Vec<Digest>,
}

impl PinnedProduct {
    /// Returns the digests of all bytes that it ever had.
    pub fn digests(&self) -> impl Iterator<Item = Digest> {
        self.others.iter().copied().chain([self.blake3])
    }
}

/// Returns all products that the lock at a path pins. Empty if there is no lock.
///
/// # Errors
/// The first file, with its line, that cannot be read.
pub fn pinned_products(lock: &Path) -> Result<Vec<PinnedProduct>, UnreadableLock> {
    let mut products = Vec::new();
    for folder in entries(lock)?.into_iter().filter(|path| path.is_dir()) {
        for file in entries(&folder)? {
            let Some(sol) = sol_of(&file) else { continue };
            let pinned = pins_in(&read(&file)?, sol);
            products.extend(pinned.map_err(|bad| unreadable(&file, Some(bad.line), bad.cause))?);
        }
    }
    Ok(products)
}

/// Returns the products that the text of a sol pins.
///
/// # Errors
/// The first line that cannot be read.
pub(crate) fn pins_in(text: &str, sol: u32) -> Result<Vec<PinnedProduct>, BadLine> {
    let pins = text::read(text, sol)?;
    let product = |(name, pin): (String, Pin)| PinnedProduct {
        sol,
        name,
        bytes: pin.bytes,
        blake3: pin.blake3,
        sha256: pin.sha256,
        url: (pin.url != WITH_LISTING).then_some(pin.url),
        fetched: pin.fetched,
        others: pin.others.into_iter().collect(),
    };
    Ok(pins.files.into_iter().map(product).collect())
}

/// Returns the sol that a file is of, by its name.
fn sol_of(file: &Path) -> Option<u32> {
    file.file_name()?
        .to_str()?
        .strip_prefix("sol-")?
        .strip_suffix(".toml")?
        .parse()
        .ok()
}

fn read(path: &Path) -> Result<String, UnreadableLock> {
    read_within(path, MAX_BYTES, Links::Followed)
        .and_then(in_utf8)
        .map_err(|error| unreadable(path, None, error.to_string()))
}

/// Returns the entries of a folder, sorted. An absent folder has none.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, UnreadableLock> {
    let failed = |error: std::io::Error| unreadable(folder, None, error.to_string());
    let listed = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        listed => listed.map_err(failed)?,
    };
    let mut paths = Vec::new();
    for entry in listed {
        paths.push(entry.map_err(failed)?.path());
    }
    paths.sort();
    Ok(paths)
}

fn unreadable(path: &Path, line: Option<usize>, cause: String) -> UnreadableLock {
    UnreadableLock {
        path: path.to_owned(),
        line,
        cause,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::super::{SolPins, write_sol};
    use super::*;
    use crate::net::Validators;

    fn pin(blake3: Digest, others: &[Digest]) -> Pin {
        Pin {
            bytes: 7,
            blake3,
            sha256: Sha256::from_content(b"bytes"),
            url: "https://host/a".to_owned(),
            fetched: "2026-11-22T08:00:00Z".to_owned(),
            validators: Validators::default(),
            listed: None,
            others: others.iter().copied().collect::<BTreeSet<_>>(),
        }
    }

    #[test]
    fn every_pinned_product_is_found_and_a_damaged_file_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let lock = dir.path().join("marf.lock");
        assert_eq!(pinned_products(&lock).unwrap(), []);
        let (one, two) = (Digest::from_content(b"one"), Digest::from_content(b"two"));
        let pins = SolPins {
            files: BTreeMap::from([("a.jpg".to_owned(), pin(one, &[two]))]),
            ..SolPins::default()
        };
        fs::create_dir_all(lock.join("navcam")).unwrap();
        fs::write(lock.join("README"), "words").unwrap();
        fs::write(lock.join("navcam/archive.toml"), "asked = \"\"").unwrap();
        let file = lock.join("navcam/sol-00042.toml");
        fs::write(&file, write_sol("navcam", 42, &pins)).unwrap();
        let found = pinned_products(&lock).unwrap();
        assert_eq!(
            (found[0].blake3, found[0].others.as_slice()),
            (one, [two].as_slice())
        );
        assert_eq!(
            (found.len(), found[0].sol, found[0].name.as_str()),
            (1, 42, "a.jpg")
        );
        fs::write(&file, "<<<<<<< ours\n").unwrap();
        let error = pinned_products(&lock).unwrap_err().to_string();
        assert!(error.contains("sol-00042.toml:1"), "{error}");
    }
}
