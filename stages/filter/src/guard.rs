//! Guards against answers that change while their version stays.

use marf_cache::Digest;
use serde_json::json;

use crate::common::{Photos, bind, defaults, mixed};
use crate::section::{Guarded, measured};
use crate::survey::GUARDS;

/// Returns the photos of the guards, all of one file size: the length of an encoded PNG depends on the encoder.
fn photos() -> Photos {
    let mut photos = mixed();
    for row in &mut photos.rows {
        row.facts["size_bytes"] = json!(50_000);
    }
    photos
}

#[test]
fn measures_change_only_with_their_version() {
    let photos = photos();
    let found = |row: &Guarded| {
        let measures = photos.measures(&*bind(row.name, defaults()));
        let line = row.measure_version.map(|version| {
            let parts = measures.iter().zip(&photos.rows).map(|(measure, photo)| {
                let part = measured(measure, photo).unwrap();
                part.map_or_else(String::into_bytes, <[u8]>::to_vec)
            });
            format!(
                "{version} {}",
                Digest::from_content(&parts.collect::<Vec<_>>().concat()).short()
            )
        });
        (row.name, line.unwrap_or_default())
    };
    let guards = GUARDS.iter();
    let expected: Vec<_> = guards
        .map(|row| (row.name, row.guard.measures.to_owned()))
        .collect();
    assert_eq!(GUARDS.iter().map(found).collect::<Vec<_>>(), expected);
}

#[test]
fn decisions_change_only_with_the_version() {
    let photos = photos();
    let found = |row: &Guarded| {
        let verdicts = serde_json::to_vec(&photos.judge(row.name, defaults())).unwrap();
        let digest = Digest::from_content(&verdicts).short();
        (row.name, format!("{} {digest}", row.version))
    };
    let guards = GUARDS.iter();
    let expected: Vec<_> = guards
        .map(|row| (row.name, row.guard.decisions.to_owned()))
        .collect();
    assert_eq!(GUARDS.iter().map(found).collect::<Vec<_>>(), expected);
}
