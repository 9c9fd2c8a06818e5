//! The packages of a checkout and the root files of their targets.

use std::collections::BTreeMap;

use crate::checkout::{Error, is_in_test_folder};

/// A package and the files that its compilations start from.
pub(crate) struct Package {
    pub name: String,
    /// Path from the root of the checkout, empty for the root itself.
    pub folder: String,
    /// The root file of the library.
    pub library: Option<String>,
    /// The root files of programs, examples and the build script.
    pub programs: Vec<String>,
}

impl Package {
    /// Returns the name of the library in paths of Rust.
    pub(crate) fn library_name(&self) -> String {
        self.name.replace('-', "_")
    }

    /// Returns the root files of all targets that are code.
    pub(crate) fn roots(&self) -> impl Iterator<Item = &str> {
        self.library
            .iter()
            .chain(&self.programs)
            .map(String::as_str)
            .filter(|path| !is_in_test_folder(path))
    }
}

/// Returns the path of a file from the folder that holds it.
pub(crate) fn join(folder: &str, below: &str) -> String {
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in below.split('/') {
        match part {
            "." | "" => {}
            ".." => {
                parts.pop();
            }
            name => parts.push(name),
        }
    }
    parts.join("/")
}

/// Returns the folder of a file.
pub(crate) fn folder(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// Returns the packages of a checkout, those deeper in folders first.
pub(crate) fn packages(texts: &BTreeMap<String, String>) -> Result<Vec<Package>, Error> {
    let mut found = Vec::new();
    for (path, text) in texts {
        if path != "Cargo.toml" && !path.ends_with("/Cargo.toml") {
            continue;
        }
        let manifest: toml::Table = text.parse().map_err(|error: toml::de::Error| Error {
            file: path.clone(),
            reason: error.to_string(),
        })?;
        if let Some(name) = text_at(&manifest, "package", "name") {
            found.push(package(name, folder(path), &manifest, texts));
        }
    }
    found.sort_by_key(|package| std::cmp::Reverse(package.folder.len()));
    Ok(found)
}

fn text_at(manifest: &toml::Table, section: &str, key: &str) -> Option<String> {
    manifest.get(section)?.get(key)?.as_str().map(str::to_owned)
}

fn package(name: String, folder: &str, manifest: &toml::Table, texts: &BTreeMap<String, String>) -> Package {
    let exists = |path: &String| texts.contains_key(path);
    let library = text_at(manifest, "lib", "path").unwrap_or_else(|| "src/lib.rs".to_owned());
    let build = text_at(manifest, "package", "build").unwrap_or_else(|| "build.rs".to_owned());
    let mut programs = vec![join(folder, &build), join(folder, "src/main.rs")];
    for section in ["bin", "example"] {
        let listed = manifest.get(section).and_then(toml::Value::as_array);
        let paths = listed
            .into_iter()
            .flatten()
            .filter_map(|target| target.get("path")?.as_str());
        programs.extend(paths.map(|path| join(folder, path)));
    }
    for place in ["src/bin", "examples"] {
        let place = format!("{}/", join(folder, place));
        programs.extend(texts.keys().filter(|path| is_target_in(path, &place)).cloned());
    }
    programs.retain(exists);
    programs.sort();
    programs.dedup();
    Package {
        name,
        folder: folder.to_owned(),
        library: Some(join(folder, &library)).filter(exists),
        programs,
    }
}

/// Returns whether cargo finds a target at a path: `FOLDER/NAME.rs` or `FOLDER/NAME/main.rs`.
fn is_target_in(path: &str, folder: &str) -> bool {
    let Some(below) = path.strip_prefix(folder) else {
        return false;
    };
    match below.split_once('/') {
        None => below.ends_with(".rs"),
        Some((_, file)) => file == "main.rs",
    }
}
