//! Keys that set or vary a size, alone and together with what the scene decides.

use crate::frame::Frame;
use crate::size_tests::{above, plane, sizes, sizes_of};
use crate::{Config, View};

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

/// Returns the numbers of a reason, in their order.
fn numbers(reason: &str) -> Vec<f64> {
    let is_of_number = |letter: char| letter.is_ascii_digit() || ",.".contains(letter);
    let words = reason.split(|letter: char| !is_of_number(letter));
    let digits = words.map(|word| word.trim_matches(['.', ',']).replace(',', ""));
    digits.filter_map(|digits| digits.parse().ok()).collect()
}

#[track_caller]
fn near(found: f64, wanted: f64, share: f64, reason: &str) {
    assert!(
        (found / wanted - 1.0).abs() < share,
        "{found}, not {wanted}: {reason}"
    );
}

/// What a reason says leads to the value that it is the reason of.
#[test]
fn values_follow_from_the_numbers_of_their_reasons() {
    let (views, points) = (above(512), plane(256));
    let frame = Frame::derive(&views, &points);
    assert_eq!(
        frame.reason,
        format!(
            "80 % of 65536 sparse points lie within {:.4} of their median",
            frame.half_side
        )
    );
    // Many points of the grid lie on the border.
    let within = |holds: fn(&f64, &f64) -> bool| {
        let reach = |point: &&[f64; 3]| {
            let reach = [0, 1, 2].map(|axis| (point[axis] - frame.origin[axis]).abs());
            holds(&reach.into_iter().fold(0.0, f64::max), &frame.half_side)
        };
        points.iter().filter(reach).count() as f64 / 65_536.0
    };
    let (inside, with_border) = (within(f64::lt), within(f64::le));
    assert!(inside <= 0.8 && 0.8 <= with_border, "{inside} {with_border}");

    let config = Config {
        steps: Some(1_000_000),
        ..Config::default()
    };
    let sizes = sizes_of(&views, &points, &config);
    let reason = &sizes.near.reason;
    assert!(
        reason.starts_with("99 % of the sparse points that cameras see are farther than"),
        "{reason}"
    );
    near(numbers(reason)[1] / 2.0, sizes.near.value, 1e-3, reason);
    let reason = &sizes.far.reason;
    assert!(
        reason.starts_with("99 % of the sparse points that cameras see are nearer than"),
        "{reason}"
    );
    let [_, farthest, times, most] = numbers(reason)[..] else {
        panic!("{reason}")
    };
    near((times * farthest).min(most), sizes.far.value, 1e-3, reason);
    // The contracted box is 4 half sides wide, and a cell as wide as a pixel.
    let reason = &sizes.finest.reason;
    let [share, narrow, middle] = numbers(reason)[..] else {
        panic!("{reason}")
    };
    assert!(share == 90.0 && narrow < middle, "{reason}");
    near(4.0 / narrow, f64::from(sizes.finest.value), 1e-3, reason);
    // 10.4 away at the median, in half sides, by 512 pixels a unit of the tangent.
    near(middle, 10.4 / frame.half_side / 512.0, 0.1, reason);

    let reason = &sizes.levels.reason;
    let [base, finest, growth, fewer, faster, most] = numbers(reason)[..] else {
        panic!("{reason}")
    };
    assert_eq!((base, finest, most), (16.0, f64::from(sizes.finest.value), 2.0));
    near(
        base * growth.powf(f64::from(sizes.levels.value) - 1.0),
        finest,
        0.05,
        reason,
    );
    near(base * faster.powf(fewer - 1.0), finest, 0.05, reason);
    assert!(growth <= most && faster > most, "{reason}");

    let reason = &sizes.log2_table.reason;
    assert!(reason.starts_with("the scene decides: "), "{reason}");
    let [cells, detail, an_entry, two, wanted, steps, samples, _, filled] = numbers(reason)[..] else {
        panic!("{reason}")
    };
    assert_eq!(
        (cells, two, steps, samples),
        (
            sizes.surface_cells.value as f64,
            2.0,
            1e6,
            f64::from(config.batch_samples)
        )
    );
    near(detail, sizes.detail.value, 1e-3, reason);
    let entries = cells * detail / an_entry;
    assert!(
        entries <= 2_f64.powf(wanted) && entries > 2_f64.powf(wanted - 1.0),
        "{reason}"
    );
    assert!(
        wanted == f64::from(sizes.log2_table.value) && filled >= wanted,
        "{reason}"
    );

    let reason = &sizes.halvings.reason;
    let [first, focal_px, last, most, sixth] = numbers(reason)[..] else {
        panic!("{reason}")
    };
    near(first, config.cone * focal_px, 0.05, reason);
    near(
        last,
        first / 2_f64.powi(sizes.halvings.value as i32),
        0.05,
        reason,
    );
    assert!(
        last <= most && 2.0 * last > most && (focal_px, most, sixth) == (512.0, 1.0, 6.0),
        "{reason}"
    );
}

#[test]
fn reasons_without_points_have_the_numbers_that_decide() {
    let views = above(8);
    let frame = Frame::derive(&views, &[]);
    // Cameras 1 and 1.005 apart that look down side by side.
    near(numbers(&frame.reason)[1], 1.005, 1e-3, &frame.reason);
    assert!(
        frame
            .reason
            .starts_with("no sparse points and no common focus: 16 baselines of "),
        "{}",
        frame.reason
    );
    near(
        16.0 * numbers(&frame.reason)[1],
        frame.half_side,
        1e-3,
        &frame.reason,
    );
    let alone = Frame::derive(&views[..1], &[]);
    assert_eq!(
        (alone.half_side, alone.reason.as_str()),
        (1.0, "all cameras share one place: one world unit")
    );
    let around: Vec<View> = crate::test_scene::ball(12, 8);
    let frame = Frame::derive(&around, &[]);
    assert!(
        frame
            .reason
            .starts_with("the optical axes of 12 of 12 cameras meet in front of them"),
        "{}",
        frame.reason
    );
    let distances = around
        .iter()
        .map(|view| (view.cam_from_world.centre() - nalgebra::Vector3::from(frame.origin)).norm());
    near(
        distances.sum::<f64>() / 12.0,
        numbers(&frame.reason)[2],
        0.05,
        &frame.reason,
    );

    let sizes = sizes_of(&views, &[], &Config::default());
    let reason = &sizes.finest.reason;
    let frame = Frame::derive(&views, &[]);
    let [pixel, depth, focal_px] = numbers(reason)[..] else {
        panic!("{reason}")
    };
    near(depth / focal_px, pixel, 1e-3, reason);
    near(depth, frame.depth / frame.half_side, 1e-3, reason);
    near(
        (4.0 / pixel).ceil().max(16.0),
        f64::from(sizes.finest.value),
        1e-3,
        reason,
    );
    // Six faces of 8 by 8 cells are more than 3 photos of 8 by 8 pixels.
    let side = f64::from(sizes.finest.value) / 2.0;
    assert_eq!(sizes.surface_cells.value, 3 * 64);
    assert_eq!(
        sizes.surface_cells.reason,
        format!(
            "one a pixel of the photos, fewer than 1,536 (no surface of sparse points: the six faces of the inner box, {side} cells a side)"
        )
    );
    assert_eq!(6.0 * side * side, 1536.0);
}

#[test]
fn the_share_of_detail_is_the_one_that_its_reason_says() {
    let mut views = above(64);
    for view in &mut views {
        view.image = marf_scene::Image::from_fn(64, 64, |column, row| [(column * row % 251) as u8; 3]).into();
    }
    let detail = sizes_of(&views, &[], &Config::default()).detail;
    // Four blocks of each of three photos.
    let said = format!(
        "three quarters of 12 blocks of 32 x 32 pixels take at most {:.3} numbers a pixel. The numbers are corners of bilinear patches of",
        detail.value
    );
    assert!(detail.reason.starts_with(&said), "{}", detail.reason);
}

/// A range that is named is the range that is taken.
#[test]
fn ranges_of_keys_are_those_that_are_taken() {
    let refused = |config: Config| config.check().err().map(|error| error.to_string());
    let cells = |occupancy_resolution| Config {
        occupancy_resolution,
        ..Config::default()
    };
    for bad in [12, 15, 18, 260] {
        assert_eq!(
            refused(cells(bad)),
            Some(format!(
                "`occupancy_resolution` is {bad}, must be 16 to 256, a multiple of 4"
            ))
        );
    }
    for fine in [16, 20, 256] {
        assert_eq!(refused(cells(fine)), None, "{fine}");
    }
    let mut sizes = sizes(&above(8), &[]);
    for bad in [0.0, -1.0, sizes.far.value, f64::NAN] {
        sizes.near.value = bad;
        let error = sizes.check(&Config::default()).unwrap_err().to_string();
        assert_eq!(error, format!("`near` is {bad}, must be above 0 and below `far`"));
    }
    sizes.near.value = sizes.far.value / 2.0;
    assert!(sizes.check(&Config::default()).is_ok());
}
