//! The reader of real archives reads the demo's files.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use std::{collections::BTreeMap, fs};

use marf_demo::{Demo, DemoOptions, FlawKind};
use marf_extract::Extract;
use marf_scene::PhotoFacts;
use marf_stage::{Define, Source, Verdict, harness::Harness};

/// Writes sol 2 into a folder and extracts it: facts by file, and verdicts.
fn extracted(demo: &Demo) -> (BTreeMap<String, PhotoFacts>, Vec<Verdict>) {
    let dir = tempfile::tempdir().unwrap();
    for file in demo.files(2, &|_, _| (), &|| false).unwrap() {
        fs::write(dir.path().join(file.name), file.bytes).unwrap();
    }
    let archive = serde_json::json!({"kind": "folder", "path": dir.path()});
    let params = serde_json::from_value(serde_json::json!({ "archive": archive })).unwrap();
    let source = <Extract>::new(params).unwrap();
    let harness = Harness::default();
    let listing = source.list(&harness.ctx()).unwrap();
    assert_eq!(listing.shards.len(), 1, "all is of one sol");
    let fetched = source.fetch(&harness.ctx(), 2).unwrap();
    let facts = fetched
        .rows
        .iter()
        .map(|row| PhotoFacts::from_json(&row.facts).unwrap());
    (
        facts.map(|facts| (facts.file.clone(), facts)).collect(),
        fetched.verdicts,
    )
}

#[test]
fn the_reader_of_real_archives_finds_every_photo_with_its_camera() {
    let demo = Demo::new(DemoOptions {
        width_px: 96,
        height_px: 72,
        seed: 1,
    })
    .unwrap();
    let truth = demo.ground_truth(2).unwrap();
    let (facts, verdicts) = extracted(&demo);
    for photo in &truth.photos {
        let facts = &facts[&photo.file];
        assert_eq!(
            (facts.width, facts.height, facts.bands, facts.sol),
            (96, 72, 3, Some(2))
        );
        assert_eq!(facts.filter.as_deref(), Some("0"), "{}", photo.file);
        assert!(!facts.thumbnail && facts.notes.is_empty(), "{facts:?}");
        let prior = facts.prior.as_ref().unwrap();
        assert_eq!(prior.frame, "ROVER_NAV_FRAME");
        assert_eq!(prior.motion_counter.len(), 10);
        let pose = prior.site_from_frame.unwrap();
        let told = pose.point(&prior.model.c.into());
        let moved = (told - nalgebra::Vector3::from(photo.site_model.c)).norm();
        assert!((0.001..0.05).contains(&moved), "{}: {moved} m", photo.file);
        let turn = pose.rotation.transpose() * photo.site_from_rover.rotation;
        let angle_deg = ((turn.trace() - 1.0) / 2.0).min(1.0).acos().to_degrees();
        assert!(
            (0.02..0.2).contains(&angle_deg),
            "{}: {angle_deg} degrees",
            photo.file
        );
    }
    for flaw in &truth.flaws {
        let verdict = verdicts.iter().find(|verdict| verdict.file == flaw.file).unwrap();
        let refused = flaw.kind == FlawKind::Truncated;
        assert_eq!(verdict.verdict == "decode", refused, "{verdict:?}");
        assert_eq!(facts.contains_key(&flaw.file), !refused, "{flaw:?}");
        if !refused {
            let thumbnail = flaw.kind == FlawKind::Thumbnail;
            assert_eq!(facts[&flaw.file].thumbnail, thumbnail, "{flaw:?}");
        }
    }
}
