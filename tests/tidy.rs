//! The arrows between rooms: who may import whom. A new arrow needs a new row here, and a reason.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Room (folder), package, and the rooms of ours it may import.
const ROOMS: [(&str, &str, &[&str]); 17] = [
    ("shaders", "marf-shaders", &[]),
    ("cache/derive", "marf-cache-derive", &[]),
    ("cache", "marf-cache", &["marf-cache-derive"]),
    ("stages/stage", "marf-stage", &["marf-cache"]),
    ("stages/numeric", "marf-numeric", &[]),
    ("stages/scene", "marf-scene", &["marf-cache"]),
    (
        "stages/field",
        "marf-field",
        &["marf-cache", "marf-scene", "marf-shaders"],
    ),
    (
        "stages/schema",
        "marf-schema",
        &["marf-cache", "marf-stage", "marf-scene", "marf-field"],
    ),
    (
        "stages/extract",
        "marf-extract",
        &["marf-cache", "marf-stage", "marf-scene"],
    ),
    (
        "stages/filter",
        "marf-filter",
        &["marf-cache", "marf-stage", "marf-scene"],
    ),
    (
        "stages/calibrate",
        "marf-calibrate",
        &["marf-cache", "marf-stage", "marf-scene", "marf-schema"],
    ),
    (
        "stages/tune",
        "marf-tune",
        &[
            "marf-cache",
            "marf-stage",
            "marf-scene",
            "marf-schema",
            "marf-field",
        ],
    ),
    (
        "stages/train",
        "marf-train",
        &[
            "marf-cache",
            "marf-stage",
            "marf-scene",
            "marf-schema",
            "marf-field",
        ],
    ),
    (
        "stages/bootstrap",
        "marf-bootstrap",
        &[
            "marf-cache",
            "marf-stage",
            "marf-scene",
            "marf-schema",
            "marf-field",
        ],
    ),
    (
        "stages",
        "marf-stages",
        &[
            "marf-stage",
            "marf-extract",
            "marf-filter",
            "marf-calibrate",
            "marf-tune",
            "marf-train",
            "marf-bootstrap",
        ],
    ),
    ("src/engine", "marf-engine", &["marf-cache", "marf-stage"]),
    (
        "",
        "marf",
        &[
            "marf-cache",
            "marf-engine",
            "marf-stage",
            "marf-stages",
            "marf-scene",
            "marf-schema",
            "marf-field",
        ],
    ),
];

/// Packages that belong to one room alone.
const FENCED: [(&str, &[&str]); 7] = [
    ("kamadak-exif", &["marf-extract"]),
    ("petgraph", &["marf-engine"]),
    ("redb", &["marf-cache"]),
    ("reqwest", &["marf-extract"]),
    ("rustls", &["marf-extract"]),
    ("tokio", &["marf-extract", "marf"]),
    ("wgpu", &["marf-field"]),
];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Names under `[dependencies]` (not the ones only tests and benches use).
fn dependencies(manifest: &Path) -> Vec<String> {
    let text =
        std::fs::read_to_string(manifest).unwrap_or_else(|error| panic!("{}: {error}", manifest.display()));
    let table: toml::Table = text.parse().unwrap();
    let names = |key: &str| -> Vec<String> {
        table
            .get(key)
            .and_then(|value| value.as_table())
            .map(|table| table.keys().cloned().collect())
            .unwrap_or_default()
    };
    names("dependencies")
}

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if path.is_dir() && !name.starts_with('.') && name != "target" && name != "out" {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn every_room_is_in_the_table_and_imports_only_what_it_may() {
    let members: toml::Table = std::fs::read_to_string(root().join("Cargo.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let listed = members["workspace"]["members"].as_array().unwrap();
    assert_eq!(
        listed.len() + 1,
        ROOMS.len(),
        "a workspace member is missing from the table of rooms"
    );
    for (folder, package, allowed) in ROOMS {
        for name in dependencies(&root().join(folder).join("Cargo.toml")) {
            let ours = name == "marf" || name.starts_with("marf-");
            assert!(
                !ours || allowed.contains(&name.as_str()),
                "{package} imports {name}: not an arrow of the table"
            );
        }
    }
}

#[test]
fn fenced_packages_stay_in_their_room() {
    let fences: BTreeMap<&str, &[&str]> = FENCED.into_iter().collect();
    for (folder, package, _) in ROOMS {
        for name in dependencies(&root().join(folder).join("Cargo.toml")) {
            let fence = fences.get(name.as_str());
            assert!(
                fence.is_none_or(|rooms| rooms.contains(&package)),
                "{package} imports {name}"
            );
        }
    }
}

#[test]
fn unsafe_code_stands_in_two_rooms_of_kernels() {
    let mut files = Vec::new();
    rust_files(&root(), &mut files);
    assert!(files.len() > 20, "only {} source files found", files.len());
    // Spelt in two parts, so that this file does not name what it looks for.
    let words = [
        concat!("allow(un", "safe_code"),
        concat!("un", "safe {"),
        concat!("un", "safe fn"),
    ];
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let fenced = file.ends_with("stages/numeric/src/instruction_set.rs")
            || file.ends_with("stages/field/src/cpu/simd.rs")
            || file.ends_with("stages/calibrate/src/simd.rs");
        let fenced = fenced
            || file
                .parent()
                .is_some_and(|folder| folder.ends_with("stages/field/src/cpu/simd"));
        assert!(
            fenced || !words.iter().any(|word| text.contains(word)),
            "{}",
            file.display()
        );
    }
}
