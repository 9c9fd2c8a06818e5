//! What extract measures of photos while it decodes them is what the filters measure of the stored photos, to the bit.
#![allow(clippy::print_stdout, reason = "a test says when it is skipped")]
#![allow(clippy::unwrap_used, reason = "a fixture that is wrong should stop the test")]

use std::path::PathBuf;

use marf_stage::{ArchiveContext, Fetched, Stage, StageDef, Table, Work, harness::Harness};
use marf_stages::stages;
use serde_json::{Value, json};

fn def(name: &str) -> &'static StageDef {
    stages().iter().find(|stage| stage.name == name).unwrap()
}

/// Returns a filter that measures pixels.
fn filter() -> Box<dyn Stage> {
    (def("blur").bind)(json!({})).unwrap()
}

/// Returns the tables that filters fill together.
fn tables() -> Vec<Table> {
    match filter().work() {
        Work::Map(map) => map.together(),
        _ => panic!("blur is a map"),
    }
}

/// Fetches every sol of an archive, with the measures of these tables.
fn fetched(harness: &Harness, archive: &Value, measures: Vec<Table>) -> Vec<Fetched> {
    let context = ArchiveContext {
        measures,
        ..ArchiveContext::default()
    };
    let extract = (def("extract").bind_archive)(json!({ "archive": archive }), context).unwrap();
    let Work::Source(source) = extract.work() else {
        panic!("extract is a source");
    };
    let listing = source.list(&harness.ctx()).unwrap();
    let shards = listing.shards.iter();
    shards
        .map(|shard| source.fetch(&harness.ctx(), shard.shard).unwrap())
        .collect()
}

/// Compares the measures that come with photos with those made of the stored photos; returns the number of photos, and that of
/// photos that were turned or made of other pixels.
fn compared(archive: &Value) -> (usize, usize) {
    let harness = Harness::default();
    let filter = filter();
    let Work::Map(map) = filter.work() else {
        panic!("blur is a map");
    };
    let (mut photos, mut changed) = (0, 0);
    for fetched in fetched(&harness, archive, tables()) {
        assert_eq!(fetched.measures.len(), fetched.rows.len() * tables().len());
        for row in &fetched.rows {
            let own = map.measure(&harness.ctx(), row, &tables()).unwrap();
            for (table, measure) in tables().iter().zip(own) {
                let mut given = fetched
                    .measures
                    .iter()
                    .filter(|given| given.id == row.id && given.table == *table);
                assert_eq!(
                    given.next().unwrap().measure,
                    measure,
                    "{} of `{}`",
                    table.name,
                    row.id
                );
                assert!(given.next().is_none(), "`{}` has two measures", row.id);
            }
            let turned = row.facts["notes"].to_string().contains("turned upright");
            changed += usize::from(turned || row.blobs.contains_key("raw"));
            photos += 1;
        }
    }
    (photos, changed)
}

#[test]
fn photos_of_the_demo_have_the_measures_of_their_stored_form() {
    let (photos, _) = compared(&json!({"kind": "demo", "width": 160}));
    assert!(photos > 0);
}

/// Products of raw pixels, mosaics, grey photos, photos turned by EXIF, odd formats and plain JPEGs.
#[test]
fn real_photos_have_the_measures_of_their_stored_form() {
    let root = std::env::var_os("MARF_SHARED_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data")),
        PathBuf::from,
    );
    let mut changed = 0;
    for name in [
        "m2020_navcam_feed",
        "m2020_sol0709_img",
        "mer_img",
        "msl_img",
        "bad-inputs",
        "dedup_mixed",
        "fox",
    ] {
        let path = root.join(name);
        if !path.is_dir() {
            println!("skipped: {name} needs ../shared/data");
            return;
        }
        let (photos, others) = compared(&json!({"kind": "folder", "path": path}));
        assert!(photos > 0, "{name}");
        println!("{name}: {photos} photos, {others} of them turned or made of raw pixels");
        changed += others;
    }
    assert!(changed > 8, "{changed}");
}

/// No stage that reads measures, or one of another version: extract measures nothing, and its rows are the same.
#[test]
fn only_wanted_tables_are_filled_and_rows_do_not_depend_on_them() {
    let (harness, archive) = (Harness::default(), json!({"kind": "demo", "width": 160}));
    let all = fetched(&harness, &archive, tables());
    let mut one = tables()[..1].to_vec();
    one.push(Table {
        version: tables()[1].version + 1,
        ..tables()[1]
    });
    for (wanted, filled) in [(Vec::new(), 0), (one, 1)] {
        let found = fetched(&harness, &archive, wanted);
        for (found, all) in found.iter().zip(&all) {
            assert_eq!(found.rows, all.rows);
            assert_eq!(found.measures.len(), filled * found.rows.len());
        }
    }
}
