//! Products of decoding photos: requested measures, and thumbnails.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; helpers of tests are not seen as tests"
)]

mod common;

use common::{bring, folder, source, stage_in};
use marf_filter::{measure_photo, tables};
use marf_scene::{Image, Photo, Srgb, encode_png};
use marf_stage::{ArchiveContext, Fetched, Table, harness::Harness};

fn noise(width: u32, height: u32) -> Image<Srgb> {
    Image::from_fn(width, height, |x, y| {
        let mixed = (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77)).wrapping_mul(0x2c1b_3c6d);
        [mixed as u8, (mixed >> 8) as u8, (mixed >> 16) as u8]
    })
}

fn fetched(folder: serde_json::Value, measures: Vec<Table>) -> Fetched {
    let context = ArchiveContext {
        measures,
        ..ArchiveContext::default()
    };
    let stage = stage_in(folder, context).unwrap();
    let harness = Harness::default();
    let source = source(stage.as_ref());
    let listing = source.list(&harness.ctx()).unwrap();
    source.fetch(&harness.ctx(), listing.shards[0].shard).unwrap()
}

#[test]
fn wanted_measures_come_with_every_photo_and_no_others() {
    let dir = tempfile::tempdir().unwrap();
    for (name, width) in [("a.png", 40), ("b.png", 50)] {
        std::fs::write(dir.path().join(name), encode_png(&noise(width, 30)).unwrap()).unwrap();
    }
    std::fs::write(
        dir.path().join("cut.png"),
        &encode_png(&noise(40, 30)).unwrap()[..900],
    )
    .unwrap();
    let wanted = |measures: Vec<Table>| {
        let found = fetched(folder(dir.path()), measures);
        assert_eq!(found.rows.len(), 2);
        let mut found: Vec<_> = found
            .measures
            .into_iter()
            .map(|given| (given.id, given.table.name, given.measure))
            .collect();
        found.sort();
        found
    };
    let harness = Harness::default();
    let expected = |tables: &[Table]| {
        let mut expected = Vec::new();
        for (name, width) in [("a.png", 40), ("b.png", 50)] {
            let photo = Photo::from(noise(width, 30));
            let measures = measure_photo(&harness.ctx(), &photo, tables).unwrap();
            let named = tables.iter().zip(measures);
            expected.extend(named.map(|(table, measure)| (name.to_owned(), table.name, measure)));
        }
        expected.sort();
        expected
    };
    assert_eq!(wanted(Vec::new()), []);
    let all = tables();
    let old = Table {
        version: all[0].version - 1,
        ..all[0]
    };
    assert_eq!(wanted(vec![old]), [], "a version that nobody fills");
    assert_eq!(wanted(vec![all[1]]), expected(&[all[1]]));
    assert_eq!(wanted(vec![all[2], all[0]]), expected(&[all[0], all[2]]));
    assert_eq!(wanted(all.clone()), expected(&all));
}

/// 64 KiB and more: a picture of noise of 400 x 100 has 120 KB as PNG.
#[test]
fn a_large_photo_has_a_thumbnail_and_a_small_one_is_its_own() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(
        dir.path().join("large.png"),
        encode_png(&noise(400, 100)).unwrap(),
    )
    .unwrap();
    std::fs::write(
        dir.path().join("small.png"),
        encode_png(&noise(100, 100)).unwrap(),
    )
    .unwrap();
    let brought = bring(folder(dir.path())).unwrap();
    let thumbnail = |id: &str| {
        let row = brought.rows.iter().find(|(_, row)| row.id == id).unwrap();
        row.1
            .blobs
            .get("thumbnail")
            .map(|digest| brought.harness.get(digest).unwrap())
    };
    assert!(thumbnail("small.png").is_none());
    let small = Photo::decode(&thumbnail("large.png").unwrap()).unwrap();
    assert_eq!((small.image.width, small.image.height), (160, 40));
}
