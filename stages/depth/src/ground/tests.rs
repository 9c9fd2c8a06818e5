//! Surfaces of invented points in a map.

use marf_scene::Scene;

use super::*;

fn frame() -> ExportFrame {
    ExportFrame::new(&Scene {
        up: Some([0.0, 0.0, 1.0]),
        metres_per_unit: Some(1.0),
        ..Scene::default()
    })
}

/// A level square of 5 x 5 points, 1 m apart.
fn square(height: f64, sigma: f64) -> Vec<Option<Surfel>> {
    let point = |index: i32| {
        Some(Surfel {
            position: Vector3::new(f64::from(index % 5), f64::from(index / 5), height),
            normal: Vector3::z(),
            color: [0, 255, 0],
            sigma,
            height_sigma: sigma,
            confirmed: true,
        })
    };
    (0..25).map(point).collect()
}

fn heights(ground: &Ground) -> Vec<f32> {
    let map = ground.clone().map(&frame()).unwrap();
    let mut read = tiff::decoder::Decoder::new(std::io::Cursor::new(map.height_tiff().unwrap())).unwrap();
    let tiff::decoder::DecodingResult::F32(heights) = read.read_image().unwrap() else {
        panic!("no floats");
    };
    heights.into_iter().filter(|height| !height.is_nan()).collect()
}

/// Checks that all 8 x 8 pixels have this height.
fn is_level(ground: &Ground, expected: f32) {
    let heights = heights(ground);
    assert_eq!(heights.len(), 64);
    for height in heights {
        assert!((height - expected).abs() < 1e-5, "{height}");
    }
}

#[test]
fn surfaces_are_filled_between_their_points_and_photos_are_weighed() {
    let mut ground = Ground::new(&frame(), Some(0.5), 1.0).unwrap();
    ground.add(&square(2.0, 0.1), 5).unwrap();
    is_level(&ground, 2.0);
    // Four times the weight: 2.0 + 0.8 x 0.1.
    ground.add(&square(2.1, 0.05), 5).unwrap();
    is_level(&ground, 2.08);
    // A roof far above hides the ground.
    ground.add(&square(5.0, 0.05), 5).unwrap();
    is_level(&ground, 5.0);
}

fn layers(ground: &Ground) -> Vec<Layer> {
    let layers = ground.tiles.values().flatten().flatten();
    layers.filter(|layer| layer.weight > 0.0).copied().collect()
}

/// One photo: 1 / 100. The two of a pair: no more. The three of three pairs, each with sigma^2 0.02 and in two photos: 0.02 / 3.
#[test]
fn both_photos_of_a_pair_count_once() {
    let mut ground = Ground::new(&frame(), Some(0.5), 1.0).unwrap();
    for variance in [0.01_f64, 0.01, 0.02 / 3.0] {
        ground.add(&square(2.0, 0.1), 5).unwrap();
        for layer in layers(&ground) {
            let cell = shown(&[layer, Layer::default()], true).unwrap();
            assert!(
                (cell.spread_m - variance.sqrt()).abs() < 1e-6,
                "{}",
                cell.spread_m
            );
        }
    }
}

#[test]
fn a_wider_pixel_is_shown_by_as_many_photos_as_its_parts() {
    let mut points = square(2.0, 0.1);
    points
        .iter_mut()
        .flatten()
        .for_each(|point| point.confirmed = false);
    let mut ground = Ground::new(&frame(), None, 0.5).unwrap();
    for photos in 1..=3 {
        ground.add(&points, 5).unwrap();
        let mut wider = ground.clone();
        wider.coarsen();
        let layers = layers(&wider);
        assert_eq!(layers.len(), 16);
        for layer in layers {
            assert_eq!(layer.photos, photos);
            assert_eq!(is_firm(&layer), photos > 1);
        }
    }
}

#[test]
fn a_jump_between_points_is_no_surface() {
    let mut points = square(0.0, 0.1);
    for point in points.iter_mut().flatten().filter(|point| point.position.x > 2.5) {
        point.position.z = 3.0;
    }
    let mut ground = Ground::new(&frame(), Some(0.5), 1.0).unwrap();
    ground.add(&points, 5).unwrap();
    // 2 m and 1 m of 4 m, by 4 m.
    assert_eq!(heights(&ground).len(), 48);
}

#[test]
fn too_many_pixels_get_wider_unless_the_user_set_them() {
    let wide = |ground: &mut Ground| {
        for row in 0..=MOST_TILES as i32 {
            ground.layers([row * SIDE, 0]);
        }
        ground.add(&square(0.0, 0.1), 5)
    };
    let mut ground = Ground::new(&frame(), None, 0.5).unwrap();
    wide(&mut ground).unwrap();
    assert_eq!(ground.pixel_m, 1.0);
    let mut ground = Ground::new(&frame(), Some(0.5), 1.0).unwrap();
    let why = wide(&mut ground).unwrap_err().to_string();
    assert!(
        why.contains("pixels of 0.5 m are too many; widen `map_cell`"),
        "{why}"
    );
}
