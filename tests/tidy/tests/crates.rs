//! The dependencies between the crates of the workspace: a new one needs a new row here, and a reason.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test that cannot go on should stop"
)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A crate of the workspace and those of ours that it may use.
struct Crate {
    folder: &'static str,
    package: &'static str,
    /// Under `[dependencies]`.
    uses: &'static [&'static str],
    /// Under `[dev-dependencies]`, in addition to those.
    tests_use: &'static [&'static str],
}

const fn row(folder: &'static str, package: &'static str, uses: &'static [&'static str]) -> Crate {
    Crate {
        folder,
        package,
        uses,
        tests_use: &[],
    }
}

/// From the lowest to the highest: a crate uses only crates above its row.
const CRATES: [Crate; 36] = [
    row("tests/tidy", "marf-tidy", &[]),
    row("shaders", "marf-shaders", &[]),
    row("cache", "marf-cache", &[]),
    row("cache/keys", "marf-keys", &["marf-cache"]),
    row("cache/remote", "marf-remote", &["marf-cache", "marf-keys"]),
    row("stages/numeric", "marf-numeric", &[]),
    row("labs/loopback", "marf-loopback", &[]),
    row("stages/stage", "marf-stage", &["marf-cache"]),
    row("stages/scene", "marf-scene", &["marf-cache", "marf-numeric"]),
    Crate {
        tests_use: &["marf-cache"],
        ..row("stages/video", "marf-video", &["marf-scene"])
    },
    row("stages/pds", "marf-pds", &["marf-scene"]),
    row(
        "stages/demo",
        "marf-demo",
        &["marf-cache", "marf-numeric", "marf-scene"],
    ),
    row("stages/depth", "marf-depth", &["marf-numeric"]),
    row("stages/field", "marf-field", &["marf-numeric", "marf-scene"]),
    Crate {
        tests_use: &["marf-numeric"],
        ..row(
            "stages/field-gpu",
            "marf-field-gpu",
            &["marf-shaders", "marf-cache", "marf-scene", "marf-field"],
        )
    },
    row(
        "stages/schema",
        "marf-schema",
        &[
            "marf-cache",
            "marf-stage",
            "marf-scene",
            "marf-video",
            "marf-field",
        ],
    ),
    row(
        "stages/sfm-features",
        "marf-sfm-features",
        &["marf-numeric", "marf-scene"],
    ),
    row(
        "stages/sfm",
        "marf-sfm",
        &["marf-numeric", "marf-scene", "marf-sfm-features"],
    ),
    Crate {
        tests_use: &["marf-loopback"],
        ..row(
            "stages/extract",
            "marf-extract",
            &["marf-cache", "marf-stage", "marf-scene", "marf-pds", "marf-demo"],
        )
    },
    row(
        "stages/filter",
        "marf-filter",
        &["marf-cache", "marf-stage", "marf-scene", "marf-pds"],
    ),
    Crate {
        tests_use: &["marf-pds", "marf-demo"],
        ..row(
            "stages/calibrate",
            "marf-calibrate",
            &[
                "marf-cache",
                "marf-numeric",
                "marf-stage",
                "marf-scene",
                "marf-schema",
                "marf-sfm-features",
                "marf-sfm",
            ],
        )
    },
    row(
        "stages/train",
        "marf-train",
        &[
            "marf-cache",
            "marf-numeric",
            "marf-stage",
            "marf-scene",
            "marf-video",
            "marf-field",
            "marf-field-gpu",
            "marf-schema",
        ],
    ),
    row(
        "stages/surface",
        "marf-surface",
        &[
            "marf-cache",
            "marf-numeric",
            "marf-stage",
            "marf-scene",
            "marf-field",
            "marf-field-gpu",
            "marf-schema",
        ],
    ),
    row(
        "stages",
        "marf-stages",
        &[
            "marf-stage",
            "marf-extract",
            "marf-filter",
            "marf-calibrate",
            "marf-train",
            "marf-surface",
        ],
    ),
    row("src/engine", "marf-engine", &["marf-cache", "marf-stage"]),
    row(
        "src/cluster",
        "marf-cluster",
        &["marf-cache", "marf-remote", "marf-stage", "marf-engine"],
    ),
    row(
        "src/config",
        "marf-config",
        &[
            "marf-cache",
            "marf-remote",
            "marf-stage",
            "marf-field",
            "marf-schema",
            "marf-stages",
            "marf-engine",
        ],
    ),
    row("src/progress", "marf-progress", &["marf-cache", "marf-engine"]),
    row(
        "src/model",
        "marf-model",
        &["marf-cache", "marf-stage", "marf-engine"],
    ),
    row(
        "src/provenance",
        "marf-provenance",
        &["marf-cache", "marf-stage", "marf-engine", "marf-model"],
    ),
    row(
        "src/export",
        "marf-export",
        &[
            "marf-cache",
            "marf-keys",
            "marf-stage",
            "marf-engine",
            "marf-model",
        ],
    ),
    Crate {
        tests_use: &["marf-video"],
        ..row(
            "src/report",
            "marf-report",
            &[
                "marf-cache",
                "marf-stage",
                "marf-scene",
                "marf-field",
                "marf-schema",
                "marf-stages",
                "marf-engine",
                "marf-progress",
                "marf-model",
            ],
        )
    },
    row(
        "src/view",
        "marf-view",
        &[
            "marf-cache",
            "marf-scene",
            "marf-field",
            "marf-field-gpu",
            "marf-report",
        ],
    ),
    row(
        "src/run",
        "marf-run",
        &[
            "marf-cache",
            "marf-keys",
            "marf-remote",
            "marf-stage",
            "marf-scene",
            "marf-field",
            "marf-field-gpu",
            "marf-calibrate",
            "marf-schema",
            "marf-stages",
            "marf-engine",
            "marf-cluster",
            "marf-config",
            "marf-progress",
            "marf-model",
            "marf-provenance",
            "marf-export",
            "marf-report",
            "marf-view",
        ],
    ),
    Crate {
        // Fuzz targets of their readers.
        tests_use: &[
            "marf-calibrate",
            "marf-cluster",
            "marf-keys",
            "marf-loopback",
            "marf-pds",
            "marf-video",
        ],
        ..row(
            "",
            "marf",
            &[
                "marf-cache",
                "marf-remote",
                "marf-stage",
                "marf-scene",
                "marf-field",
                "marf-schema",
                "marf-engine",
                "marf-config",
                "marf-progress",
                "marf-export",
                "marf-provenance",
                "marf-report",
                "marf-view",
                "marf-run",
            ],
        )
    },
    row(
        "labs",
        "marf-labs",
        &[
            "marf-cache",
            "marf-numeric",
            "marf-loopback",
            "marf-stage",
            "marf-scene",
            "marf-demo",
            "marf-field",
            "marf-field-gpu",
            "marf-schema",
            "marf-stages",
            "marf-engine",
            "marf-config",
            "marf-run",
        ],
    ),
];

/// Packages that only these crates may use.
const RESTRICTED: [(&str, &[&str]); 20] = [
    ("axum", &["marf-view"]),
    ("clap", &["marf", "marf-labs"]),
    ("clap_complete", &["marf"]),
    ("clap_mangen", &["marf"]),
    ("hyper", &["marf-view"]),
    ("hyper-util", &["marf-view"]),
    ("indicatif", &["marf"]),
    ("kamadak-exif", &["marf-pds"]),
    // The laboratory is not part of the released program.
    ("marf-loopback", &["marf-labs"]),
    ("object_store", &["marf-remote"]),
    ("openh264", &["marf-video"]),
    ("petgraph", &["marf-engine"]),
    ("rav1e", &["marf-video"]),
    ("reflink-copy", &["marf-cache"]),
    ("reqwest", &["marf-extract", "marf-remote"]),
    ("ring", &["marf-cache", "marf-keys"]),
    ("rusqlite", &["marf-cache"]),
    ("rustls", &["marf-extract", "marf-remote"]),
    ("tokio", &["marf-extract", "marf-remote", "marf-view"]),
    ("wgpu", &["marf-field-gpu"]),
];

/// Where `unsafe` may stand: a variable set before any thread runs, a handler of a signal that does nothing, detection of instruction sets,
/// and the kernels written for them.
const UNSAFE: [&str; 5] = [
    "src/main.rs",
    "stages/numeric/src/instruction_set.rs",
    "stages/field/src/cpu/simd.rs",
    "stages/field/src/cpu/simd/",
    "stages/sfm-features/src/simd.rs",
];

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
