//! The files of a checkout, read from disk or given as text.

use std::collections::BTreeMap;
use std::path::Path;

use crate::packages::{Package, packages};
use crate::source::Source;

/// Folders whose Rust files are not code of the program.
const TEST_FOLDERS: [&str; 3] = ["benches", "fuzz", "tests"];

/// A file that could not be read.
#[derive(Debug)]
pub struct Error {
    /// Path of the file.
    pub file: String,
    /// What is wrong with it.
    pub reason: String,
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.file, self.reason)
    }
}

impl std::error::Error for Error {}

/// The parsed Rust files of a checkout and its packages.
pub struct Checkout {
    pub(crate) sources: BTreeMap<String, Source>,
    pub(crate) packages: Vec<Package>,
}

impl Checkout {
    /// Reads every `.rs` file and `Cargo.toml` below a folder. Build output and folders whose name starts with a dot
    /// are left out.
    ///
    /// # Errors
    /// Returns the first file that cannot be read or parsed.
    pub fn read(root: &Path) -> Result<Self, Error> {
        let mut texts = BTreeMap::new();
        read_folder(root, "", &mut texts)?;
        Self::from_texts(&texts)
    }

    /// Parses the files of a checkout, given by their path from its root.
    ///
    /// # Errors
    /// Returns the first file that cannot be parsed.
    pub fn from_texts(texts: &BTreeMap<String, String>) -> Result<Self, Error> {
        let packages = packages(texts)?;
        let sources = texts
            .iter()
            .filter(|(path, _)| path.ends_with(".rs"))
            .map(|(path, text)| Ok((path.clone(), Source::parse(path, text)?)))
            .collect::<Result<_, Error>>()?;
        Ok(Self { sources, packages })
    }
}

/// Returns whether a file is in a folder of tests, benchmarks or fuzzers.
pub(crate) fn is_in_test_folder(path: &str) -> bool {
    let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
    folder.split('/').any(|name| TEST_FOLDERS.contains(&name))
}

fn read_folder(root: &Path, folder: &str, texts: &mut BTreeMap<String, String>) -> Result<(), Error> {
    let error = |file: &str, error: std::io::Error| Error {
        file: file.to_owned(),
        reason: error.to_string(),
    };
    let entries = std::fs::read_dir(root.join(folder)).map_err(|source| error(folder, source))?;
    for entry in entries {
        let entry = entry.map_err(|source| error(folder, source))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = if folder.is_empty() {
            name.clone()
        } else {
            format!("{folder}/{name}")
        };
        let kind = entry.file_type().map_err(|source| error(&path, source))?;
        if kind.is_dir() {
            if !name.starts_with('.') && name != "target" && name != "out" {
                read_folder(root, &path, texts)?;
            }
        } else if name.ends_with(".rs") || name == "Cargo.toml" {
            let text = std::fs::read_to_string(root.join(&path)).map_err(|source| error(&path, source))?;
            texts.insert(path, text);
        }
    }
    Ok(())
}
