//! The numbers in the reason of a size are those that it was worked out from.

use marf_scene::{Camera, Image, Pose};
use nalgebra::Vector3;

use crate::frame::Frame;
use crate::size_tests::{above, plane, sizes};
use crate::{Config, View};

/// Returns the numbers of a text in their order.
fn numbers(text: &str) -> Vec<f64> {
    let words = text.split(|letter: char| letter.is_whitespace() || letter == '^' || letter == '(');
    let bare = words.map(|word| {
        word.trim_end_matches(|end: char| !end.is_ascii_digit())
            .replace(',', "")
    });
    bare.filter_map(|word| word.parse().ok()).collect()
}

fn looking(eyes: &[[f64; 3]], target: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Vec<View> {
    let view = |eye: &[f64; 3]| {
        let eye = Vector3::from(*eye);
        View {
            id: format!("{eye}"),
            camera: Camera::pinhole(32, 24, 40.0),
            cam_from_world: Pose::looking_at(eye, target(eye), Vector3::z()),
            image: Image::from_fn(1, 1, |_, _| [9; 3]).into(),
        }
    };
    eyes.iter().map(view).collect()
}

#[test]
fn reasons_of_sizes_have_the_numbers_that_they_follow_from() {
    let (views, points) = (above(512), plane(256));
    let frame = Frame::derive(&views, &points);
    let sizes = sizes(&views, &points);
    // Seen straight down the points are 10 away, in the corners 12.1.
    let near = numbers(&sizes.near.reason);
    assert!(
        near[0] == 99.0 && (sizes.near.value - 0.5 * near[1]).abs() < 1e-4,
        "{near:?} {:?}",
        sizes.near
    );
    assert!((10.0..10.1).contains(&(near[1] * frame.half_side)), "{near:?}");
    let far = numbers(&sizes.far.reason);
    assert!(
        far[0] == 99.0 && far[2] == 8.0 && (sizes.far.value - (8.0 * far[1]).min(far[3])).abs() < 0.001,
        "{far:?} {:?}",
        sizes.far
    );
    assert!((11.4..12.2).contains(&(far[1] * frame.half_side)), "{far:?}");
    let step = numbers(&sizes.halvings.reason);
    let pixels = Config::default().cone * 512.0;
    let last = pixels * 0.5_f64.powi(sizes.halvings.value as i32);
    assert!(
        (step[0] - pixels).abs() <= 0.05
            && step[1] == 512.0
            && (step[2] - last).abs() <= 0.005
            && step[3] == 1.0,
        "{step:?} {pixels} {last}"
    );
    let levels = numbers(&sizes.levels.reason);
    let grown = levels[0] * levels[2].powi(sizes.levels.value as i32 - 1);
    assert!(
        levels[1] == f64::from(sizes.finest.value) && (grown / levels[1] - 1.0).abs() < 0.03,
        "{levels:?}"
    );
    let surface = numbers(&sizes.surface_cells.reason);
    let expected = surface[1] * surface[4];
    assert!(
        surface[0] == 65_536.0 && (sizes.surface_cells.value as f64 / expected - 1.0).abs() < 0.01,
        "{surface:?} {:?}",
        sizes.surface_cells
    );
    let table = numbers(&sizes.log2_table.reason);
    let wanted = (table[0] * table[1] / table[2]).log2().ceil();
    assert!(
        table[0] == sizes.surface_cells.value as f64 && table[2] == 4.0 && (table[4] - wanted).abs() < 0.5,
        "{table:?}"
    );
}

#[test]
fn without_points_the_faces_of_the_box_are_counted_but_no_more_than_the_pixels() {
    let unseen = sizes(&above(512), &[]).surface_cells;
    let (_, side) = unseen
        .reason
        .split_once("the six faces of the inner box, ")
        .unwrap();
    let faces = 6.0 * numbers(side)[0].powi(2);
    let pixels = 3.0 * 512.0 * 512.0;
    assert_eq!(unseen.value as f64, faces.min(pixels), "{unseen:?}");
    let is_capped = unseen
        .reason
        .starts_with("one a pixel of the photos, fewer than ");
    assert_eq!(is_capped, faces > pixels, "{unseen:?}");
    assert!(!is_capped || numbers(&unseen.reason)[0] == faces, "{unseen:?}");
}

#[test]
fn the_reason_of_a_box_has_the_numbers_that_it_follows_from() {
    let points = plane(64);
    let of_points = Frame::derive(&above(64), &points);
    let half_side = numbers(&of_points.reason)[2];
    let inside = |point: &&[f64; 3]| point.iter().all(|along| along.abs() <= half_side + 1e-4);
    let share = points.iter().filter(inside).count() as f64 / points.len() as f64;
    assert!(
        of_points.reason.starts_with("80 % of 4096 sparse points") && (0.77..0.83).contains(&share),
        "{share} {of_points:?}"
    );
    let around = [
        [3.0, 0.0, 0.0],
        [0.0, 3.0, 0.0],
        [-3.0, 0.0, 0.0],
        [0.0, -3.0, 0.0],
    ];
    let of_axes = Frame::derive(&looking(&around, |_| Vector3::zeros()), &[]);
    assert_eq!(
        of_axes.reason,
        "the optical axes of 4 of 4 cameras meet in front of them, at a median distance of 3.0000"
    );
    // Parallel axes, 0.5 apart.
    let row = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0]];
    let ahead = |eye: Vector3<f64>| eye + Vector3::y();
    let of_row = Frame::derive(&looking(&row, ahead), &[]);
    assert_eq!(
        (of_row.reason.as_str(), of_row.half_side),
        (
            "no sparse points and no common focus: 16 baselines of 0.5000",
            8.0
        )
    );
    let one = Frame::derive(&looking(&[[1.0; 3]; 2], ahead), &[]);
    assert_eq!(
        (one.reason.as_str(), one.half_side),
        ("all cameras share one place: one world unit", 1.0)
    );
}
