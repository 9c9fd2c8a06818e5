//! All products that a marf.lock pins, of all archives: what a collection must keep.

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use marf_cache::Digest;

use super::{SolPins, old, text};

/// A lock that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}{}: {cause}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
pub struct UnreadableLock {
    path: PathBuf,
    line: Option<usize>,
    cause: String,
}

/// Returns the digests of all products that the lock at a path pins, in either form; none if there is no lock.
///
/// # Errors
/// The first file, with its line, that cannot be read.
pub fn pinned_products(lock: &Path) -> Result<Vec<Digest>, UnreadableLock> {
    Ok(pins_by_name(lock)?.into_values().flatten().collect())
}

/// Returns what archives gave under each name, by sol and name: first the bytes that are pinned, then others that were given
/// later. Archives of one lock that have a name of one sol in common are joined.
///
/// # Errors
/// As [`pinned_products`].
pub fn pins_by_name(lock: &Path) -> Result<BTreeMap<(u32, String), Vec<Digest>>, UnreadableLock> {
    let mut given = BTreeMap::new();
    if lock.is_file() {
        let archives = old::read(&read(lock)?).map_err(|bad| unreadable(lock, Some(bad.line), bad.cause))?;
        for (sol, pins) in archives.into_values().flat_map(|archive| archive.sols) {
            add(sol, pins, &mut given);
        }
        return Ok(given);
    }
    for folder in entries(lock)?.into_iter().filter(|path| path.is_dir()) {
        for file in entries(&folder)? {
            let Some(sol) = sol_of(&file) else { continue };
            let pins = text::read(&read(&file)?, sol);
            add(
                sol,
                pins.map_err(|bad| unreadable(&file, Some(bad.line), bad.cause))?,
                &mut given,
            );
        }
    }
    Ok(given)
}

fn add(sol: u32, pins: SolPins, given: &mut BTreeMap<(u32, String), Vec<Digest>>) {
    for (name, pin) in pins.files {
        let all = given.entry((sol, name)).or_default();
        all.push(pin.blake3);
        all.extend(pin.others);
    }
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
    fs::read_to_string(path).map_err(|error| unreadable(path, None, error.to_string()))
}

/// Returns the entries of a folder, sorted; an absent one has none.
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
    use std::collections::BTreeSet;

    use super::super::{Pin, write_sol};
    use super::*;
    use crate::net::Validators;

    fn pin(blake3: Digest, others: &[Digest]) -> Pin {
        Pin {
            bytes: 7,
            blake3,
            sha256: None,
            url: "https://host/a".to_owned(),
            fetched: "2026-11-22T08:00:00Z".to_owned(),
            validators: Validators::default(),
            listed: None,
            others: others.iter().copied().collect::<BTreeSet<_>>(),
        }
    }

    #[test]
    fn every_pinned_digest_is_found_and_a_damaged_file_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let lock = dir.path().join("marf.lock");
        assert_eq!(pinned_products(&lock).unwrap(), []);
        let (one, two) = (Digest::of(b"one"), Digest::of(b"two"));
        let pins = SolPins {
            files: BTreeMap::from([("a.jpg".to_owned(), pin(one, &[two]))]),
            ..SolPins::default()
        };
        fs::create_dir_all(lock.join("navcam")).unwrap();
        fs::write(lock.join("README"), "words").unwrap();
        fs::write(lock.join("navcam/archive.toml"), "asked = \"\"").unwrap();
        let file = lock.join("navcam/sol-00042.toml");
        fs::write(&file, write_sol("navcam", 42, &pins)).unwrap();
        assert_eq!(pinned_products(&lock).unwrap(), [one, two]);
        fs::write(&file, "<<<<<<< ours\n").unwrap();
        let error = pinned_products(&lock).unwrap_err().to_string();
        assert!(error.contains("sol-00042.toml:1"), "{error}");
    }
}
