//! Normals of a slanted plane, and what moves between its photos.

use marf_scene::Frame;
use marf_stage::harness::Harness;
use nalgebra::{Vector2, Vector3};

use crate::plane_photos::{on_plane, painted};
use crate::stage_tests::{PLACES, classes, has_text, run, scene};

/// Along each of its baselines the patch moves by 12 % of it, once with it and once against it, so that its depths by the two pairs of
/// the first photo are 13 % too large and 11 % too small.
#[test]
fn what_moves_between_photos_has_no_depth_and_a_class_of_its_own() {
    let harness = Harness::default();
    let mut scene = scene(&harness, &PLACES);
    for (frame, share) in scene.frames.iter_mut().zip([0.0, 0.12, -0.12]) {
        let [x, y, _] = <[f64; 3]>::from(frame.cam_from_world.centre());
        let moved = Some([share * x, share * y]);
        frame.image = painted(&harness, &frame.camera, &frame.cam_from_world, moved);
    }
    let outputs = run(&harness, &scene);
    let class = classes(&harness.get(&outputs["class/0.png"]).unwrap());
    let frame = &scene.frames[0];
    let inside = |index: usize| {
        let at = Vector2::new((index % 160) as f64 + 0.5, (index / 160) as f64 + 0.5);
        let point = on_plane(&frame.camera, &frame.cam_from_world, &at);
        point.x.abs() < 0.8 && point.y.abs() < 0.6
    };
    let (patch, around): (Vec<usize>, Vec<usize>) = (0..class.len()).partition(|index| inside(*index));
    let differing = |pixels: &[usize]| pixels.iter().filter(|index| class[**index] == 4).count();
    assert!(
        2 * differing(&patch) > patch.len(),
        "{} of {}",
        differing(&patch),
        patch.len()
    );
    assert!(
        20 * differing(&around) < around.len(),
        "{} of {}",
        differing(&around),
        around.len()
    );
}

#[test]
fn normals_of_a_plane_point_towards_the_camera() {
    let harness = Harness::default();
    let scene = scene(&harness, &PLACES);
    let outputs = run(&harness, &scene);
    let png = harness.get(&outputs["normal/0.png"]).unwrap();
    assert!(has_text(
        &png,
        "(x right, y down, z forward) = (value - 128) / 127"
    ));
    let picture = image::load_from_memory(&png).unwrap().into_rgba8();
    let Frame {
        camera,
        cam_from_world,
        ..
    } = &scene.frames[0];
    let seen = |x: f64, y: f64| cam_from_world.point(&on_plane(camera, cam_from_world, &Vector2::new(x, y)));
    let mut off_deg = Vec::new();
    for (column, row, pixel) in picture
        .enumerate_pixels()
        .filter(|(_, _, pixel)| pixel.0[3] == 255)
    {
        let (x, y) = (f64::from(column) + 0.5, f64::from(row) + 0.5);
        let (right, down) = (seen(x + 0.1, y) - seen(x, y), seen(x, y + 0.1) - seen(x, y));
        let truth = down.cross(&right).normalize();
        let [r, g, b, _] = pixel.0.map(|value| (f64::from(value) - 128.0) / 127.0);
        let normal = Vector3::new(r, g, b);
        assert!((normal.norm() - 1.0).abs() < 0.02, "{normal}");
        off_deg.push(libm::acos(normal.normalize().dot(&truth).min(1.0)).to_degrees());
    }
    assert!(off_deg.len() > 160 * 120 * 4 / 5, "{}", off_deg.len());
    let median_deg = marf_numeric::upper_median(off_deg).unwrap();
    assert!(median_deg < 5.0, "{median_deg}");
}
