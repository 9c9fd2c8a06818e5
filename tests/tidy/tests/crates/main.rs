//! The dependencies between the crates of the workspace: a new one needs a new row here, and a reason.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

mod table;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use table::{CRATES, Crate, RESTRICTED, UNSAFE};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Returns the names in one section of a manifest.
fn section(manifest: &Path, section: &str) -> Vec<String> {
    let text =
        std::fs::read_to_string(manifest).unwrap_or_else(|error| panic!("{}: {error}", manifest.display()));
    let table: toml::Table = text.parse().unwrap();
    let found = table.get(section).and_then(|value| value.as_table());
    found
        .map(|table| table.keys().cloned().collect())
        .unwrap_or_default()
}

fn manifest(krate: &Crate) -> PathBuf {
    root().join(krate.folder).join("Cargo.toml")
}

fn is_ours(package: &str) -> bool {
    package == "marf" || package.starts_with("marf-")
}

/// Returns every Rust file below a folder with its path from there, build output left out.
fn rust_files(root: &Path, folder: &Path, found: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap_or_default();
        let name = name.to_string_lossy().into_owned();
        if path.is_dir() && !name.starts_with('.') && name != "target" && name != "out" {
            rust_files(root, &path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let below = path.strip_prefix(root).unwrap();
            found.push(below.to_string_lossy().replace('\\', "/"));
        }
    }
}

#[test]
fn every_member_of_the_workspace_has_a_row() {
    let workspace: toml::Table = std::fs::read_to_string(root().join("Cargo.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let listed = workspace["workspace"]["members"].as_array().unwrap();
    let mut listed: BTreeSet<&str> = listed.iter().map(|member| member.as_str().unwrap()).collect();
    listed.insert("");
    let rows: BTreeSet<&str> = CRATES.iter().map(|krate| krate.folder).collect();
    assert_eq!(listed, rows);
}

#[test]
fn crates_use_only_what_their_row_allows() {
    for krate in &CRATES {
        for name in section(&manifest(krate), "dependencies") {
            assert!(
                !is_ours(&name) || krate.uses.contains(&name.as_str()),
                "{} uses {name}, which its row does not allow",
                krate.package
            );
        }
        for name in section(&manifest(krate), "dev-dependencies") {
            assert!(
                !is_ours(&name)
                    || krate.uses.contains(&name.as_str())
                    || krate.tests_use.contains(&name.as_str()),
                "tests of {} use {name}, which its row does not allow",
                krate.package
            );
        }
    }
}

#[test]
fn rows_allow_nothing_that_is_not_used_and_nothing_below_them() {
    let mut above: BTreeSet<&str> = BTreeSet::new();
    for krate in &CRATES {
        let used = section(&manifest(krate), "dependencies");
        let tested = section(&manifest(krate), "dev-dependencies");
        for name in krate.uses {
            assert!(
                above.contains(name),
                "{} allows {name}, which stands below it",
                krate.package
            );
            assert!(
                used.contains(&(*name).to_owned()),
                "{} allows {name} and does not use it",
                krate.package
            );
        }
        for name in krate.tests_use {
            assert!(
                tested.contains(&(*name).to_owned()),
                "tests of {} do not use {name}",
                krate.package
            );
        }
        above.insert(krate.package);
    }
}

#[test]
fn restricted_packages_are_used_only_where_they_belong() {
    let restricted: BTreeMap<&str, &[&str]> = RESTRICTED.into_iter().collect();
    for krate in &CRATES {
        for name in section(&manifest(krate), "dependencies") {
            let crates = restricted.get(name.as_str());
            assert!(
                crates.is_none_or(|crates| crates.contains(&krate.package)),
                "{} uses {name}",
                krate.package
            );
        }
    }
}

#[test]
fn unsafe_code_stands_only_in_the_files_of_kernels() {
    let mut files = Vec::new();
    rust_files(&root(), &root(), &mut files);
    assert!(files.len() > 20, "only {} source files found", files.len());
    // Spelt in two parts, so that this file does not contain what it searches for.
    let words = [
        concat!("allow(un", "safe_code"),
        concat!("un", "safe {"),
        concat!("un", "safe fn"),
    ];
    for file in files.iter().filter(|file| {
        !UNSAFE
            .iter()
            .any(|place| *file == place || (place.ends_with('/') && file.starts_with(place)))
    }) {
        let text = std::fs::read_to_string(root().join(file)).unwrap();
        assert!(!words.iter().any(|word| text.contains(word)), "{file}");
    }
}
