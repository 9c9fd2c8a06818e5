//! Keys that set or vary a size, alone and together with what the scene decides.

use crate::Config;
use crate::size_tests::{above, plane, sizes_of};

#[test]
fn a_key_that_is_set_wins_and_says_so() {
    let config = Config {
        levels: Some(12),
        log2_table: Some(10),
        finest_resolution: Some(99),
        near: Some(0.25),
        far: Some(3.0),
        ..Config::default()
    };
    let sizes = sizes_of(&above(64), &plane(64), &config);
    let said = [
        (f64::from(sizes.levels.value), 12.0, sizes.levels.reason, "levels"),
        (
            f64::from(sizes.log2_table.value),
            10.0,
            sizes.log2_table.reason,
            "log2_table",
        ),
        (
            f64::from(sizes.finest.value),
            99.0,
            sizes.finest.reason,
            "finest_resolution",
        ),
        (sizes.near.value, 0.25, sizes.near.reason, "near"),
        (sizes.far.value, 3.0, sizes.far.reason, "far"),
    ];
    for (found, wanted, reason, key) in said {
        assert_eq!((found, reason), (wanted, format!("`{key}` says so")), "{key}");
    }
}

/// A search varies sizes around what the scene asks for.
#[test]
fn a_factor_and_a_shift_vary_what_is_derived_and_what_is_said() {
    let (views, points) = (above(512), plane(64));
    let with = |config: Config| sizes_of(&views, &points, &config);
    let asked = with(Config::default());
    let varied = with(Config {
        finest_factor: 0.5,
        log2_table_shift: -2,
        ..Config::default()
    });
    let half = f64::from(asked.finest.value) / 2.0;
    assert!((f64::from(varied.finest.value) - half).abs() <= 0.5, "{varied:?}");
    assert!(
        varied.finest.reason.starts_with("`finest_factor` is 0.5; ")
            && varied.finest.reason.ends_with(&asked.finest.reason),
        "{}",
        varied.finest.reason
    );
    // A quarter of the cells of the surface want a quarter of the table, and the shift makes it a quarter of that.
    assert_eq!(varied.log2_table.value + 4, asked.log2_table.value, "{varied:?}");
    let reason = &varied.log2_table.reason;
    assert!(
        reason.starts_with("`log2_table_shift` is -2: ") && reason.contains("want 2^"),
        "{reason}"
    );

    let said = |finest_factor: f64, log2_table_shift: i32| {
        let sizes = with(Config {
            finest_resolution: Some(4096),
            finest_factor,
            log2_table: Some(22),
            log2_table_shift,
            ..Config::default()
        });
        (sizes.finest.value, sizes.log2_table.value)
    };
    assert_eq!(said(1.0, 0), (4096, 22));
    assert_eq!(said(2.0, 1), (8192, 23));
    assert_eq!(said(8.0, 4), (8192, 24), "at the ends they stay");
    assert_eq!(said(0.125, -4), (512, 18));
    let least = with(Config {
        finest_resolution: Some(16),
        finest_factor: 0.125,
        log2_table: Some(8),
        log2_table_shift: -4,
        ..Config::default()
    });
    assert_eq!((least.finest.value, least.log2_table.value), (16, 8));
}

#[test]
fn keys_of_a_search_that_are_not_set_leave_no_trace_in_what_is_stored() {
    let stored = serde_json::to_value(Config::default()).unwrap();
    assert!(stored.get("log2_table_shift").is_none() && stored.get("finest_factor").is_none());
    for config in [
        Config {
            log2_table_shift: 5,
            ..Config::default()
        },
        Config {
            finest_factor: 0.1,
            ..Config::default()
        },
        Config {
            finest_factor: f64::NAN,
            ..Config::default()
        },
    ] {
        assert!(config.check().is_err(), "{config:?}");
    }
}

#[test]
fn near_gives_way_to_a_far_that_is_set_and_far_to_a_near() {
    let (views, points) = (above(64), plane(64));
    let config = |near, far| Config {
        near,
        far,
        ..Config::default()
    };
    let close = sizes_of(&views, &points, &config(None, Some(0.001)));
    assert_eq!(
        (close.near.value, close.far.value),
        (0.0005, 0.001),
        "{}",
        close.near.reason
    );
    // Points 10 away in a box of half side 3.6: far would be 8 times 3 half sides.
    let away = sizes_of(&views, &points, &config(Some(10.0), None));
    assert!(away.far.value > 20.0, "{}", away.far.reason);
    for (near, far) in [
        (Some(2.0), Some(2.0)),
        (Some(2.0), Some(1.0)),
        (None, Some(0.0)),
        (None, Some(f64::NAN)),
    ] {
        let error = config(near, far).check().unwrap_err().to_string();
        assert!(error.starts_with("`far` is "), "{near:?} {far:?}: {error}");
    }
}

#[test]
fn the_smaller_of_what_the_scene_wants_and_the_budget_fills_is_taken() {
    let table = |steps| {
        let config = Config {
            steps: Some(steps),
            ..Config::default()
        };
        sizes_of(&above(512), &plane(256), &config).log2_table
    };
    // 2^22 samples: 4 times fewer entries than the 2^16 of 8 times as many.
    let short = table(128);
    assert!(
        short.value == 14 && short.reason.starts_with("the budget decides: 128 steps"),
        "{short:?}"
    );
    let long = table(1 << 20);
    assert!(
        long.value == 16 && long.reason.starts_with("the scene decides: "),
        "{long:?}"
    );
    for steps in [1, u64::MAX] {
        assert!(
            (12..=16).contains(&table(steps).value),
            "{steps}: {:?}",
            table(steps)
        );
    }
}
