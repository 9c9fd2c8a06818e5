//! Which crates may use which.

/// A crate of the workspace and those of ours that it may use.
pub struct Crate {
    pub folder: &'static str,
    pub package: &'static str,
    /// Under `[dependencies]`.
    pub uses: &'static [&'static str],
    /// Under `[dev-dependencies]`, in addition to those.
    pub tests_use: &'static [&'static str],
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
pub const CRATES: [Crate; 36] = [
    row("tests/tidy", "marf-tidy", &[]),
    row("shaders", "marf-shaders", &[]),
    row("cache", "marf-cache", &[]),
    row("cache/keys", "marf-keys", &["marf-cache"]),
    row("cache/remote", "marf-remote", &["marf-cache", "marf-keys"]),
    row("stages/numeric", "marf-numeric", &[]),
    row("labs/loopback", "marf-loopback", &[]),
    row("stages/stage", "marf-stage", &["marf-cache", "marf-numeric"]),
    row("stages/scene", "marf-scene", &["marf-cache", "marf-numeric"]),
    Crate {
        tests_use: &["marf-cache"],
        ..row("stages/video", "marf-video", &["marf-scene"])
    },
    row("stages/pds", "marf-pds", &["marf-numeric", "marf-scene"]),
    row(
        "stages/demo",
        "marf-demo",
        &["marf-cache", "marf-numeric", "marf-scene"],
    ),
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
    row(
        "stages/filter",
        "marf-filter",
        &["marf-cache", "marf-stage", "marf-scene", "marf-pds"],
    ),
    Crate {
        tests_use: &["marf-loopback"],
        ..row(
            "stages/extract",
            "marf-extract",
            &[
                "marf-cache",
                "marf-stage",
                "marf-scene",
                "marf-pds",
                "marf-demo",
                "marf-filter",
            ],
        )
    },
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
        "stages/depth",
        "marf-depth",
        &[
            "marf-cache",
            "marf-numeric",
            "marf-stage",
            "marf-scene",
            "marf-schema",
            "marf-surface",
        ],
    ),
    row(
        "stages/train",
        "marf-train",
        &[
            "marf-cache",
            "marf-numeric",
            "marf-stage",
            "marf-scene",
            "marf-depth",
            "marf-video",
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
            "marf-depth",
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
    row(
        "src/progress",
        "marf-progress",
        &["marf-cache", "marf-stage", "marf-engine"],
    ),
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
                "marf-numeric",
            ],
        )
    },
    row(
        "src/view",
        "marf-view",
        &[
            "marf-cache",
            "marf-numeric",
            "marf-scene",
            "marf-field",
            "marf-field-gpu",
            "marf-surface",
            "marf-depth",
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
            "marf-depth",
            "marf-pds",
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
            "marf-extract",
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
            "marf-depth",
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
pub const RESTRICTED: [(&str, &[&str]); 19] = [
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
pub const UNSAFE: [&str; 5] = [
    "src/main.rs",
    "stages/numeric/src/instruction_set.rs",
    "stages/field/src/cpu/simd.rs",
    "stages/field/src/cpu/simd/",
    "stages/sfm-features/src/simd.rs",
];
