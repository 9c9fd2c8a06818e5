//! Sizes worked out by hand, what they do when the photos or the points change, and points that are of no use.

use marf_scene::{Camera, Image, Pose};
use nalgebra::Vector3;
use proptest::prelude::*;

use crate::cpu::simd::LANES;
use crate::frame::Frame;
use crate::size::{Sizes, derive};
use crate::test_scene::{ball, ball_view, psnr, small, trained};
use crate::{Config, DepthSource, PixelDistance, View, ViewDependence};

/// Cameras in a row, 10 above the plane z = 0, looking down. Photos have `side` pixels a side.
pub fn above(side: u32) -> Vec<View> {
    let eyes = [[-1.0, 0.0], [0.0, 0.1], [1.0, 0.0]];
    let view = |[x, y]: [f64; 2]| View {
        id: format!("{x}"),
        camera: Camera::pinhole(side, side, f64::from(side)),
        cam_from_world: Pose::looking_at(Vector3::new(x, y, 10.0), Vector3::new(x, y, 0.0), Vector3::y()),
        image: Image::from_fn(1, 1, |_, _| [0; 3]).into(),
        distances: Vec::new(),
    };
    eyes.map(view).into()
}

/// `[count^2]` points of a square of side 8 in the plane z = 0, in the middles of its cells.
pub fn plane(count: u32) -> Vec<[f64; 3]> {
    let at = |index: u32| (f64::from(index) + 0.5) / f64::from(count) * 8.0 - 4.0;
    let cell = |index: u32| [at(index % count), at(index / count), 0.0];
    (0..count * count).map(cell).collect()
}

pub fn sizes_of(views: &[View], points: &[[f64; 3]], config: &Config) -> Sizes {
    let frame = Frame::derive(views, points);
    let sizes = derive(views, points, points.len(), config, &frame);
    sizes
        .check(config)
        .unwrap_or_else(|error| panic!("{error}: {sizes:?}"));
    assert!((sizes.levels.value as usize * config.features as usize).is_multiple_of(LANES));
    sizes
}

pub fn sizes(views: &[View], points: &[[f64; 3]]) -> Sizes {
    sizes_of(views, points, &Config::default())
}

#[test]
fn a_plane_is_sized_by_hand() {
    let (views, points) = (above(512), plane(256));
    let frame = Frame::derive(&views, &points);
    // 80 % of the points of a square have a maximum norm below sqrt(0.8) of half its side.
    assert!((frame.half_side - 0.8_f64.sqrt() * 4.0).abs() < 0.05, "{frame:?}");
    let sizes = sizes(&views, &points);
    // Points are 10 away straight down, at most 12.1 in the corners. A pixel covers 10.4 / 512 at the median.
    let near = sizes.near.value * frame.half_side;
    let far = sizes.far.value * frame.half_side;
    assert!((5.0..5.1).contains(&near), "{near}: {}", sizes.near.reason);
    assert!(
        (8.0 * 11.4..8.0 * 12.1).contains(&far),
        "{far}: {}",
        sizes.far.reason
    );
    // A tenth of the points in view is within 2.3 of the foot of its camera: 10 to 10.3 away.
    let cells = [10.3, 10.0].map(|depth| (4.0 * frame.half_side * 512.0 / depth) as u32);
    assert!(
        (cells[0]..=cells[1]).contains(&sizes.finest.value),
        "{cells:?}: {}",
        sizes.finest.reason
    );
    // 16 to about 700 cells: 4 levels would grow by 3.5, 8 grow by 1.7.
    assert_eq!(sizes.levels.value, 8, "{}", sizes.levels.reason);
    assert!(
        sizes.levels.reason.contains("4 levels would grow by 3.5"),
        "{}",
        sizes.levels.reason
    );
    // The inner box is half of the contracted one, 350 cells a side. The rim of 12 % a side is contracted.
    let inner = (f64::from(sizes.finest.value) / 2.0).powi(2);
    let ratio = sizes.surface_cells.value as f64 / inner;
    assert!(
        (1.0..1.4).contains(&ratio),
        "{ratio}: {}",
        sizes.surface_cells.reason
    );
    // 130,000 to 170,000 cells, 4 an entry.
    assert_eq!(sizes.log2_table.value, 16, "{}", sizes.log2_table.reason);
}

#[test]
fn the_last_steps_at_matter_near_and_far_are_at_most_a_pixel_long() {
    for (side, height) in [(64, 10.0), (512, 10.0), (512, 0.5), (1920, 0.1)] {
        let mut views = above(side);
        let (eye, target) = (Vector3::new(0.5, 0.5, height), Vector3::new(0.5, 0.5, 0.0));
        views[1].cam_from_world = Pose::looking_at(eye, target, Vector3::y());
        let points = plane(256);
        let frame = Frame::derive(&views, &points);
        let sizes = sizes(&views, &points);
        let steps = sizes.steps(&Config::default(), sizes.halvings.value);
        // From the near percentile of the points in view, twice `near`, to the far one, an eighth of `far`.
        let seen = 2.0 * sizes.near.value..=sizes.far.value / 8.0;
        let pairs = steps.begin.iter().zip(&steps.length).take(steps.count);
        let longest = pairs
            .map(|(begin, length)| (f64::from(*begin), f64::from(*length)))
            .filter(|(begin, _)| seen.contains(begin))
            .map(|(begin, length)| length / begin * f64::from(side));
        let longest = longest.fold(0.0, f64::max);
        assert!(
            (0.5..=1.0 + 1e-5).contains(&longest) || side == 1920,
            "{side}, {height}: {longest} px, {frame:?}"
        );
        // 1,920 px would need 7 halvings.
        assert!(longest <= 1.3, "{side}, {height}: {longest} px");
    }
}

#[test]
fn close_ups_decide_the_finest_cells_and_a_single_one_does_not() {
    let (points, far) = (plane(256), above(512));
    let low = |views: &mut [View]| {
        for view in views {
            let at = view.cam_from_world.centre();
            let (eye, foot) = (Vector3::new(at.x, at.y, 1.0), Vector3::new(at.x, at.y, 0.0));
            view.cam_from_world = Pose::looking_at(eye, foot, Vector3::y());
        }
    };
    let finest = |views: &[View]| f64::from(sizes(views, &points).finest.value);
    let mut both = [far.clone(), far.clone()].concat();
    // Cameras at a tenth of the height see 1 / 64 of the plane each. The others see all of that.
    low(&mut both[..3]);
    assert!(
        (finest(&both) / finest(&far) - 1.0).abs() < 0.05,
        "{}",
        finest(&both)
    );
    // As many points in the pictures near the ground as in those from above: cells a tenth as wide.
    let mut near: Vec<View> = far.iter().cycle().take(60).cloned().collect();
    low(&mut near[..57]);
    let ratio = finest(&near) / finest(&far);
    assert!((8.0..=11.0).contains(&ratio), "{ratio}");
}

#[test]
fn photos_of_twice_the_resolution_have_twice_the_cells_a_side_and_four_times_the_surface() {
    let points = plane(128);
    for side in [128, 256, 512] {
        let (one, two) = (sizes(&above(side), &points), sizes(&above(2 * side), &points));
        let finest = f64::from(two.finest.value) / f64::from(one.finest.value);
        let surface = two.surface_cells.value as f64 / one.surface_cells.value as f64;
        assert!(
            (finest - 2.0).abs() < 0.01 && (surface - 4.0).abs() < 0.02,
            "{side}: {finest}, {surface}"
        );
        assert!(two.log2_table.value > one.log2_table.value, "{side}: {two:?}");
        assert_eq!((&one.near, &one.far), (&two.near, &two.far), "{side}");
    }
}

#[test]
fn points_far_away_widen_far_and_leave_near() {
    let mut points = plane(64);
    let before = sizes(&above(256), &points);
    points.extend((0..200).map(|index| [f64::from(index % 20) - 10.0, f64::from(index / 20) - 5.0, -90.0]));
    let after = sizes(&above(256), &points);
    assert!(
        after.far.value > 4.0 * before.far.value,
        "{} {}",
        before.far.reason,
        after.far.reason
    );
    assert!(
        (after.near.value / before.near.value - 1.0).abs() < 0.1,
        "{} {}",
        before.near.reason,
        after.near.reason
    );
}

#[test]
fn the_weight_of_the_distortion_loss_follows_the_number_of_photos_and_what_points_tell() {
    let many = |count: usize| above(8).into_iter().cycle().take(count).collect::<Vec<_>>();
    for (photos, points, weights, said) in [
        (
            3,
            plane(10),
            [0.03, 0.03],
            "3 photos to train on are fewer than 24",
        ),
        (23, plane(10), [0.03, 0.03], "23 photos"),
        (24, plane(10), [0.0, 0.1], "24 photos to train on, 24 or more"),
        (3, Vec::new(), [0.0, 0.1], "no sparse points"),
        (24, Vec::new(), [0.0, 0.1], "24 photos"),
    ] {
        let found = sizes(&many(photos), &points).distortion;
        assert_eq!(found.value, weights, "{found:?}");
        assert!(found.reason.contains(said), "{found:?}");
        let config = Config {
            distortion: Some(0.5),
            ..Config::default()
        };
        let found = sizes_of(&many(photos), &points, &config).distortion;
        assert_eq!(
            (found.value, found.reason.as_str()),
            ([0.5; 2], "`distortion` says so")
        );
    }
    for weight in [-1e-9, 1.1, f64::NAN, f64::INFINITY] {
        let mut sizes = sizes(&above(8), &plane(10));
        sizes.distortion.value[1] = weight;
        let refused = sizes.check(&Config::default()).unwrap_err().to_string();
        assert!(refused.contains("distortion"), "{refused}");
    }
}

#[test]
fn points_pull_for_half_of_the_steps_and_longer_where_photos_are_few() {
    for (photos, steps, expected, said) in [
        (24, Some(400), 200, "half of 400 steps, 1,000 at most"),
        (24, Some(1), 1, "half of 1 steps"),
        (24, Some(1_999), 999, "half of 1,999 steps"),
        (24, Some(u64::MAX), 1_000, "1,000 at most"),
        (24, None, 1_000, "not known"),
        (23, Some(400), 1_000, "23 photos to train on, fewer than 24"),
    ] {
        let views: Vec<_> = above(8).into_iter().cycle().take(photos).collect();
        let config = Config {
            steps,
            ..Config::default()
        };
        let found = sizes_of(&views, &plane(22), &config).depth_steps;
        assert_eq!(found.value, expected, "{found:?}");
        assert!(found.reason.contains(said), "{found:?}");
    }
    let config = Config {
        depth_steps: Some(3),
        ..Config::default()
    };
    let said = sizes_of(&above(8), &[], &config);
    assert_eq!(said.depth_steps.value, 3);
    let none = sizes(&above(8), &[]).depth_steps;
    assert_eq!((none.value, &*none.reason), (1_000, "there are no sparse points"));
    let pairs = Config {
        depth_source: DepthSource::Pairs,
        ..Config::default()
    };
    let mut views = above(8);
    let without = sizes_of(&views, &plane(22), &pairs).depth_steps.reason;
    assert!(
        without.contains("sparse points (no pair of them shows distances) for"),
        "{without}"
    );
    let distance = PixelDistance {
        pixel: [0, 0],
        distance: 1.0,
        sigma: 0.1,
    };
    views[2].distances = vec![distance; 1200];
    let bare = sizes_of(&views, &[], &pairs).depth_steps.reason;
    assert!(bare.contains("need 1,200 distances"), "{bare}");
    let with = sizes_of(&views, &plane(22), &pairs).depth_steps.reason;
    assert!(
        with.contains("need sparse points and 1,200 distances from pairs of them for"),
        "{with}"
    );
    let sky = PixelDistance {
        distance: f32::INFINITY,
        ..distance
    };
    views[1].distances = vec![sky; 1100];
    let with_sky = sizes_of(&views, &[], &pairs).depth_steps.reason;
    assert!(
        with_sky.contains("1,200 distances from pairs of them and 1,100 pixels of sky for"),
        "{with_sky}"
    );
    let mut read: Sizes = serde_json::from_value(serde_json::to_value(&said).unwrap()).unwrap();
    read.check(&config).unwrap();
    read.depth_steps.value = 0;
    let refused = read.check(&config).unwrap_err().to_string();
    assert!(refused.contains("depth_steps"), "{refused}");
}

#[test]
fn tables_are_pulled_to_zero_where_photos_are_few_and_overlap_little() {
    for (photos, points, pull, said) in [
        (
            1,
            0,
            1e-5,
            "1 photos to train on, 9 or fewer, and 0 sparse points",
        ),
        (9, 449, 1e-5, "9 photos"),
        (
            9,
            450,
            0.0,
            "450 sparse points of 9 photos to train on, 50 a photo or more",
        ),
        (10, 0, 0.0, "10 photos to train on, more than 9"),
    ] {
        let views: Vec<_> = above(8).into_iter().cycle().take(photos).collect();
        let found = sizes(&views, &plane(22)[..points]).table_decay;
        assert_eq!(found.value, pull, "{found:?}");
        assert!(found.reason.contains(said), "{found:?}");
    }
    let config = Config {
        table_decay: Some(0.5),
        ..Config::default()
    };
    let said = sizes_of(&above(8), &[], &config);
    assert_eq!(said.table_decay.value, 0.5);
    let mut read: Sizes = serde_json::from_value(serde_json::to_value(&said).unwrap()).unwrap();
    read.check(&config).unwrap();
    for pull in [-1e-9, 1.1, f64::NAN, f64::INFINITY] {
        read.table_decay.value = pull;
        let refused = read.check(&config).unwrap_err().to_string();
        assert!(refused.contains("table_decay"), "{refused}");
    }
}

#[test]
fn without_points_the_reasons_say_so() {
    let sizes = sizes(&above(256), &[]);
    assert_eq!((sizes.near.value, sizes.far.value), (0.1, 512.0));
    for reason in [&sizes.near.reason, &sizes.far.reason] {
        assert!(reason.starts_with("no sparse points: "), "{reason}");
    }
    assert!(
        sizes.surface_cells.reason.contains("no surface of sparse points"),
        "{}",
        sizes.surface_cells.reason
    );
}

#[test]
fn photos_without_detail_ask_for_a_small_table_and_a_short_training_decides_before_them() {
    let table = |wave_px: f64, steps: Option<u64>| {
        let gray = |column: u32, row: u32| {
            let at = |index: u32| (f64::from(index) * std::f64::consts::TAU / wave_px).sin();
            [(128.0 + 50.0 * at(column) + 50.0 * at(row)).round() as u8; 3]
        };
        let mut views = above(512);
        for view in &mut views {
            view.image = Image::from_fn(512, 512, gray).into();
        }
        let config = Config {
            steps,
            ..Config::default()
        };
        let sizes = sizes_of(&views, &plane(256), &config);
        (sizes.log2_table.value, sizes.log2_table.reason)
    };
    // The table for detail in every pixel is that of `a_plane_is_sized_by_hand`.
    let tables = [6.0, 24.0, 48.0, 96.0, 400.0].map(|wave_px| table(wave_px, None).0);
    assert_eq!((tables[0], tables[4]), (16, 12), "{tables:?}");
    assert!(
        tables.is_sorted_by(|shorter, longer| longer <= shorter),
        "{tables:?}"
    );
    assert!((13..=15).contains(&tables[2]), "{tables:?}");
    let (short, reason) = table(6.0, Some(100));
    assert!(short < 16 && reason.starts_with("the budget decides"), "{reason}");
    let (_, reason) = table(400.0, Some(1_000_000));
    assert!(reason.starts_with("the scene decides"), "{reason}");
}

/// Every extreme goes through the checks of `sizes`: finite, near below far, levels and table in range.
#[test]
fn points_that_are_of_no_use_are_told_from_those_that_are() {
    let few = sizes(&above(64), &[[0.0; 3]]);
    assert!(
        few.near
            .reason
            .starts_with("1 sparse points are fewer than the 32 needed"),
        "{}",
        few.near.reason
    );
    let behind: Vec<_> = plane(16).iter().map(|[x, y, _]| [*x, *y, 20.0]).collect();
    let unseen = sizes(&above(64), &behind);
    assert!(
        unseen.near.reason.starts_with("no camera sees any of 256"),
        "{}",
        unseen.near.reason
    );
    let same = sizes(&above(64), &[[0.5, 0.5, 0.0]; 100]);
    assert!(
        same.surface_cells.reason.contains("no surface"),
        "{}",
        same.surface_cells.reason
    );
    let mut far = plane(64);
    far.extend([[1e9, 1e9, -1e9], [0.0, 0.0, -1e9], [0.0, 0.0, -1e300]]);
    let (far, plain) = (sizes(&above(64), &far), sizes(&above(64), &plane(64)));
    assert!(
        (far.far.value / plain.far.value - 1.0).abs() < 0.05,
        "{} {}",
        far.far.reason,
        plain.far.reason
    );
    let on_cameras: Vec<_> = (0..100)
        .map(|index| [f64::from(index % 3) - 1.0, 0.0, 10.0 - 1e-12])
        .collect();
    let near = sizes(&above(64), &on_cameras);
    assert!(near.near.value >= 1e-4, "{}", near.near.reason);
    let all_far: Vec<_> = plane(16)
        .iter()
        .map(|[x, y, _]| [x * 1e8, y * 1e8, -1e9])
        .collect();
    sizes(&above(64), &all_far);
}

/// A ball without gloss is learnt as well by a colour network that does not know where it is seen from.
#[test]
fn without_view_dependence_there_are_fewer_weights_and_a_dull_ball_is_learnt_as_well() {
    let found = [ViewDependence::On, ViewDependence::Off].map(|view_dependence| {
        let config = Config {
            view_dependence,
            batch_samples: 4096,
            ..small()
        };
        // A seed alone moves the figure by half a decibel.
        let fields = [4, 5, 6].map(|seed| trained(ball(24, 16), &config, seed, 600).field().unwrap());
        let sum: f64 = fields
            .iter()
            .map(|field| psnr(field, &ball_view(0.4, 0.3, 16)))
            .sum();
        (sum / fields.len() as f64, fields[0].facts().parameters)
    });
    let [(with, more), (without, fewer)] = found;
    // 16 harmonics into 16 neurons.
    assert_eq!(more - fewer, 256);
    assert!(
        without > 18.0 && without > with - 0.5,
        "{with} dB with, {without} dB without"
    );
}

proptest! {
    #[test]
    fn no_cloud_of_points_breaks_a_size(
        points in prop::collection::vec(prop::array::uniform3(-1e4..1e4_f64), 0..200),
        side in 1_u32..2000,
        steps in prop::option::of(1_u64..1_000_000),
    ) {
        let config = Config { steps, ..Config::default() };
        let sizes = sizes_of(&above(side), &points, &config);
        prop_assert!((12..=22).contains(&sizes.log2_table.value), "{:?}", sizes);
    }
}
