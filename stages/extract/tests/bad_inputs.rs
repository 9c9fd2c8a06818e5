//! Hostile files: a verdict each, no panic, bounded memory.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests are not seen as tests"
)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::{bring, folder, real, stage};

#[test]
fn every_bad_input_gets_a_verdict() {
    let Some(path) = real("bad-inputs") else { return };
    let before_kb = peak_kb();
    let brought = bring(folder(&path)).unwrap();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for verdict in &brought.verdicts {
        *counts.entry(verdict.verdict.as_str()).or_default() += 1;
        assert_eq!(verdict.keeps(), verdict.reason.is_empty(), "{verdict:?}");
    }
    let files = count_files(&path);
    let used = brought
        .rows
        .iter()
        .filter(|(_, row)| row.blobs.contains_key("label"))
        .count();
    println!(
        "{files} files: {counts:?}, {used} labels used, peak {before_kb:?} -> {:?} kB",
        peak_kb()
    );
    // Every file is a row, a label that a row uses, or a verdict.
    let hidden = brought
        .verdicts
        .iter()
        .filter(|verdict| verdict.reason.starts_with("a hidden "));
    assert_eq!(brought.verdicts.len() + used, files + hidden.count());
    assert_eq!(counts["keep"], brought.rows.len());
    if let Some(peak) = peak_kb() {
        assert!(peak < 2 << 20, "{peak} kB");
    }
    for (file, verdict, part) in [
        ("own/bomb_20000x20000_rgb.png", "decode", ""),
        ("own/hdr_65535x65535.png", "decode", ""),
        ("own/html_404.jpg", "decode", "not a JPEG"),
        ("own/empty.png", "decode", "an empty file"),
        ("own/billion_laughs.xml", "skipped", "DTD"),
        ("own/xxe_file.xml", "skipped", "DTD"),
        ("own/deep_100000.xml", "skipped", ""),
        ("own/cahvor_NaN.xml", "skipped", "Product_Observational"),
        ("own/latin1_lie.xml", "skipped", "UTF-8"),
        ("own/tf_deep.json", "skipped", ""),
        ("own/index_hostile.html", "skipped", "`.html`"),
        ("pillow/Tests/images/truncated_jpeg.jpg", "decode", "JPEG"),
        (
            "pillow/Tests/images/crash-338516dbd2f0e83caddb8ce256c22db3bd6dc40f.tif",
            "decode",
            "TIFF: ",
        ),
    ] {
        let found = brought.verdict(file);
        assert_eq!(found.verdict, verdict, "{found:?}");
        assert!(found.reason.contains(part), "{found:?}");
    }
    for (_, row) in &brought.rows {
        let facts = brought.facts(&row.id);
        let corrupt = facts.file.contains("pngsuite/png/x");
        assert!(!corrupt, "{} must be refused", facts.file);
    }
}

#[test]
fn every_cut_and_bent_img_ends_in_a_verdict() {
    let Some(path) = real("labels") else { return };
    let whole = std::fs::read(path.join("3778ML1037770010808163I01_DXXX.IMG")).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let mut state = 12_345_u64;
    for index in 0..200 {
        let mut bytes = whole.clone();
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let place = (state >> 33) as usize % bytes.len();
        if index % 2 == 0 {
            bytes.truncate(place);
        } else {
            for offset in 0..8 {
                let at = (place * (offset + 1)) % bytes.len();
                bytes[at] = bytes[at].wrapping_mul(31).wrapping_add(index as u8);
            }
        }
        std::fs::write(dir.path().join(format!("bent_{index:03}.img")), bytes).unwrap();
    }
    let brought = bring(folder(dir.path())).unwrap();
    assert_eq!(brought.verdicts.len(), 200);
    assert!(
        brought
            .verdicts
            .iter()
            .all(|verdict| verdict.keeps() == verdict.reason.is_empty())
    );
}

fn count_files(path: &Path) -> usize {
    let shown = |entry: &std::fs::DirEntry| !entry.file_name().to_string_lossy().starts_with('.');
    let entries = std::fs::read_dir(path)
        .unwrap()
        .map(|entry| entry.unwrap())
        .filter(shown);
    entries
        .map(|entry| {
            if entry.path().is_dir() {
                count_files(&entry.path())
            } else {
                1
            }
        })
        .sum()
}

/// Peak memory of this process, kB, if the system reports it.
fn peak_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[test]
fn archives_with_bad_keys_say_so() {
    let fail = |archive: serde_json::Value, path: &str, part: &str| {
        let error = stage(archive).err().unwrap();
        assert_eq!(error.path, path, "{error}");
        assert!(error.message.contains(part), "{error}");
    };
    for kind in ["pds", "feed"] {
        let archive =
            serde_json::json!({"kind": kind, "mission": "mars2020", "instrument": "navcam", "sols": "1..=5"});
        fail(archive, "archive.mission", "unknown variant `mars2020`");
    }
    fail(
        serde_json::json!({"kind": "folder", "path": "x", "sols": "5..=1"}),
        "archive.sols",
        "empty range",
    );
    fail(
        serde_json::json!({"kind": "folder", "path": "x", "sol": 1}),
        "archive.sol",
        "unknown field `sol`",
    );
    fail(serde_json::json!({"kind": "tape"}), "archive.kind", "tape");
}
