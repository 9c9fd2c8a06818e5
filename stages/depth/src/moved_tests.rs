//! What moves between the photos of a slanted plane.

use marf_stage::harness::Harness;
use nalgebra::Vector2;

use crate::plane_photos::{on_plane, painted};
use crate::stage_tests::{PLACES, classes, run, scene};

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
