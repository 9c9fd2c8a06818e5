//! Filters that compare photos with each other: by instrument, independent of sols.

use std::collections::BTreeMap;

use crate::common::{Photos, bind, by_id, defaults, item, mixed};
use marf_cache::manifest::Row;
use marf_stage::{Map, Verdict, Work, harness::decide};
use proptest::prelude::*;
use serde_json::json;

/// Returns the verdicts of a filter on photos spread over these sols.
fn spread(photos: &Photos, measures: &[Vec<u8>], map: &dyn Map, sols: &[u32]) -> BTreeMap<String, Verdict> {
    let mut shards = BTreeMap::<u32, Vec<_>>::new();
    for (at, sol) in sols.iter().enumerate() {
        let own = item(*sol, &photos.rows[at], &measures[at]);
        // The order within a sol is another one too.
        shards.entry(*sol).or_default().insert(0, own);
    }
    let shards: Vec<_> = shards.into_values().collect();
    by_id(decide(map, &shards).unwrap().concat())
}

/// Photos of two instruments, of several sizes, two of them thumbnails.
fn of_two_instruments() -> Photos {
    let mut photos = mixed();
    for (at, row) in photos.rows.iter_mut().enumerate() {
        row.facts["instrument"] = json!(["ZL", "NL"][at % 2]);
        row.facts["width"] = json!([640, 1280, 640, 330][at % 4]);
        row.facts["height"] = json!([480, 960, 480, 250][at % 4]);
        row.facts["thumbnail"] = json!(at % 6 == 5);
    }
    photos
}

#[test]
fn photos_of_an_instrument_are_compared_with_each_other_alone() {
    let photos = of_two_instruments();
    for (name, params) in comparisons() {
        let stage = bind(name, params.clone());
        let measures = photos.measures(&*stage);
        let items: Vec<_> = photos
            .rows
            .iter()
            .zip(&measures)
            .map(|(row, measure)| item(0, row, measure))
            .collect();
        let all = photos.decide(&*stage, &items);
        for first in [0, 1] {
            let own: Vec<_> = items.iter().skip(first).step_by(2).copied().collect();
            let expected: Vec<_> = all.iter().skip(first).step_by(2).cloned().collect();
            assert_eq!(photos.decide(&*stage, &own), expected, "{name} {params}");
        }
    }
}

/// Filters that compare photos, with params that make them do so among six.
fn comparisons() -> [(&'static str, serde_json::Value); 6] {
    [
        ("shape", json!({"min_set": 3})),
        ("shape", json!({"min_set": 2, "common_share": 0.0})),
        ("histogram", json!({"min_set": 3})),
        ("histogram", json!({"rule": "paper"})),
        ("blur", json!({"min_set": 3})),
        (
            "blur",
            json!({"min_set": 6, "floor_ratio": 0.01, "ceiling_ratio": 1e6}),
        ),
    ]
}

/// What is kept of a set is kept as long as its context is: the bytes of equal contexts are equal.
#[test]
fn a_context_does_not_depend_on_photos_that_change_no_decision() {
    let mut photos = Photos::default();
    (0..9).for_each(|at| {
        photos.add_with(&format!("photo-{at}"), b"never opened", |facts| {
            (facts.width, facts.height) = (1440, 1920);
        });
    });
    let stage = bind("shape", defaults());
    let Work::Map(map) = stage.work() else {
        panic!("shape is a map");
    };
    let comparison = map.comparison().unwrap();
    let context = |rows: &[Row]| {
        let items: Vec<_> = rows.iter().map(|row| item(0, row, &[])).collect();
        let summary = comparison.summarise(0, &[], &items).unwrap();
        comparison
            .context(0, &[], &mut [Ok(summary.into())].into_iter())
            .unwrap()
    };
    assert_eq!(
        context(&photos.rows[..4]),
        Vec::<u8>::new(),
        "fewer than five are not compared"
    );
    assert_eq!(context(&photos.rows[..5]), context(&photos.rows));
    photos.rows[0].facts["height"] = json!(1600);
    assert_eq!(
        context(&photos.rows[1..]),
        context(&photos.rows),
        "another size, not a short one"
    );
    photos.rows[0].facts["width"] = json!(700);
    photos.rows[1].facts["width"] = json!(700);
    photos.rows[1].facts["height"] = json!(1600);
    assert_ne!(
        context(&photos.rows[2..]),
        context(&photos.rows),
        "two strips are a format"
    );
}

#[test]
fn a_summary_that_was_damaged_is_an_error_that_names_the_filter() {
    for (name, params) in comparisons() {
        let stage = bind(name, params);
        let Work::Map(map) = stage.work() else {
            panic!("{name} is a map");
        };
        let comparison = map.comparison().unwrap();
        // More instruments than follow, one without a part, and one with a part that says more follow.
        for damaged in [&b"\x02"[..], b"\x01\0", b"\x01\0\xff"] {
            let summary = Ok(damaged.into());
            let error = comparison
                .context(0, &[], &mut [summary].into_iter())
                .unwrap_err();
            assert_eq!(
                error.to_string(),
                format!("a summary of filter `{name}` cannot be read")
            );
            let error = map.decide(damaged, &[]).unwrap_err();
            assert_eq!(
                error.to_string(),
                format!("a context of filter `{name}` cannot be read")
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn verdicts_do_not_depend_on_how_photos_are_spread_over_sols(sols in prop::collection::vec(0_u32..5, 12..=12)) {
        thread_local!(static SET: (Photos, Vec<Vec<Vec<u8>>>) = {
            let photos = of_two_instruments();
            let measures = comparisons().map(|(name, params)| photos.measures(&*bind(name, params)));
            (photos, measures.to_vec())
        });
        SET.with(|(photos, measures)| {
            for ((name, params), measures) in comparisons().into_iter().zip(measures) {
                let stage = bind(name, params.clone());
                let Work::Map(map) = stage.work() else {
                    panic!("{name} is a map");
                };
                let one_sol = spread(photos, measures, map, &[0; 12]);
                prop_assert_eq!(spread(photos, measures, map, &sols), one_sol, "{} {}", name, params);
            }
            Ok(())
        })?;
    }
}
