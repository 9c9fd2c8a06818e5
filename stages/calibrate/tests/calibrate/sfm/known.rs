//! Points of photos whose cameras another program found.

use marf_calibrate::Tracks;
use marf_calibrate::import::read_tracks;

use super::*;

/// What structure from motion finds of the demo's first photos, and these photos with the cameras alone in a `transforms.json`.
fn handed_on(params: &serde_json::Value) -> (Output, Input) {
    let mut input = demo().0;
    input.split_off(16);
    let found = input.run(params).unwrap();
    let mut other = Input::default();
    for frame in &found.scene.frames {
        other.plain(&frame.file, &input.harness.get(&frame.image).unwrap());
    }
    let mut cameras: serde_json::Value = serde_json::from_str(&found.transforms).unwrap();
    cameras.as_object_mut().unwrap().remove("ply_file_path").unwrap();
    other.companion("transforms.json", &serde_json::to_vec(&cameras).unwrap());
    (found, other)
}

fn tracks(output: &Output) -> Tracks {
    let [_, images, points] = &output.model;
    read_tracks(&output.scene, ["images.bin", "points3D.bin"], images, points).unwrap()
}

/// Returns the distance of an observation from the projection of its point, the largest of all.
fn farthest_px(output: &Output) -> f64 {
    let tracks = tracks(output);
    let distance = |position: Vector3<f64>, observation: &marf_calibrate::Observation| {
        let frame = &output.scene.frames[observation.frame as usize];
        let pixel = frame
            .camera
            .project(&frame.cam_from_world.point(&position))
            .unwrap();
        (pixel - Vector2::from(observation.pixel)).norm()
    };
    let all = tracks.points.iter().flat_map(|point| {
        let observations = point.observations.iter();
        observations.map(|observation| distance(point.position.into(), observation))
    });
    all.fold(0.0, f64::max)
}

/// The same points as those that were found with the cameras: nine in ten of them, to a centimetre at four metres.
#[test]
fn cameras_without_points_get_those_that_the_photos_to_train_on_show() {
    let (found, input) = handed_on(&json!({"method": "sfm"}));
    let output = input.run(&json!({"method": "import"})).unwrap();
    assert!(
        output.metrics.method.ends_with(&format!(
            ", {} points found in the photos",
            output.scene.points.len()
        )),
        "{}",
        output.metrics.method
    );
    let seen = |scene: &marf_scene::Scene, point: &[f64; 3]| {
        let near = scene
            .points
            .iter()
            .map(|other| (Vector3::from(other.position) - Vector3::from(*point)).norm());
        near.fold(f64::INFINITY, f64::min)
    };
    let mut distances: Vec<f64> = output
        .scene
        .points
        .iter()
        .map(|point| seen(&found.scene, &point.position))
        .collect();
    distances.sort_by(f64::total_cmp);
    let (count, before) = (distances.len(), found.scene.points.len());
    println!(
        "{count} points, {before} before; {:.4} m, {:.4} m",
        distances[count / 2],
        distances[count * 9 / 10]
    );
    assert!(count * 10 >= before * 6, "{count} of {before}");
    assert!(distances[count / 2] < 0.01, "{}", distances[count / 2]);
    for photo in &output.metrics.photos {
        // A held-out photo contributes nothing to the field that it judges.
        assert_eq!(photo.error_px.is_none(), photo.held_out, "{photo:?}");
        assert!(photo.error_px.is_none_or(|error| error < 1.0), "{photo:?}");
    }
    let frames = &output.scene.frames;
    let observed: std::collections::BTreeSet<u32> = tracks(&output)
        .points
        .iter()
        .flat_map(|point| &point.observations)
        .map(|one| one.frame)
        .collect();
    let trained = (0..frames.len() as u32).filter(|index| !frames[*index as usize].held_out);
    assert!(trained.eq(observed));
    // Cameras stay to the bit.
    for (frame, before) in frames.iter().zip(&found.scene.frames) {
        assert!((frame.cam_from_world.centre() - before.cam_from_world.centre()).norm() < 1e-12);
    }
    let without = input
        .run(&json!({"method": "import", "find_points": false}))
        .unwrap();
    assert!(without.scene.points.is_empty());
    assert_eq!(without.metrics.method, "import of transforms.json");
}

/// Of reduced photos, too, whoever has found the cameras.
#[test]
fn observations_lie_where_their_points_do_in_the_photos_of_the_scene() {
    let (found, input) = handed_on(&json!({"method": "sfm", "longest_side_px": 200}));
    assert_eq!(
        found.scene.frames[0]
            .camera
            .width
            .max(found.scene.frames[0].camera.height),
        160
    );
    assert!(farthest_px(&found) < 1.5, "{}", farthest_px(&found));
    let output = input
        .run(&json!({"method": "import", "longest_side_px": 100}))
        .unwrap();
    assert!(!output.scene.points.is_empty());
    assert!(farthest_px(&output) < 1.0, "{}", farthest_px(&output));
}
