//! The stage on photos of a slanted plane.

use marf_scene::picture::png16::read_quantity;
use marf_scene::{Camera, Frame, Image, Point, Pose, Scene, encode_png};
use marf_schema::depth::{DepthParams, Metrics};
use marf_schema::output::{POINTS, SCENE};
use marf_stage::{Define, Inputs, Outputs, Set, TypedOutputs, harness::Harness};
use nalgebra::{Vector2, Vector3};

use crate::plane_photos::{height, on_plane, painted};
use crate::{DistanceSample, MakeDepth, TargetDetail};

fn frame(harness: &Harness, index: usize, place: Vector3<f64>) -> Frame {
    let pose = Pose::looking_at(place, Vector3::new(0.0, 0.0, 10.0), Vector3::y());
    photo(harness, index, pose, 160.0)
}

/// A photo by a camera of this pose and focal length.
fn photo(harness: &Harness, index: usize, pose: Pose, focal_px: f64) -> Frame {
    let camera = Camera {
        k1: 0.02,
        ..Camera::pinhole(160, 120, focal_px)
    };
    Frame {
        id: format!("{index}"),
        file: format!("{index}.png"),
        image: painted(harness, &camera, &pose, None),
        mask: None,
        camera,
        cam_from_world: pose,
        held_out: false,
        error_px: None,
    }
}

pub(crate) fn scene(harness: &Harness, places: &[[f64; 3]]) -> Scene {
    let frames = places.iter().enumerate();
    let points = (0..100).map(|index| {
        let (x, y) = (f64::from(index % 10) - 4.5, f64::from(index / 10) * 0.6 - 2.7);
        Point {
            position: [x, y, height(y)],
            color: None,
            views: 3,
        }
    });
    Scene {
        frames: frames
            .map(|(index, place)| frame(harness, index, Vector3::from(*place)))
            .collect(),
        points: points.collect(),
        up: Some([0.0, -1.0, 0.0]),
        metres_per_unit: Some(2.0),
        ..Scene::default()
    }
}

pub(crate) fn run(harness: &Harness, scene: &Scene) -> Outputs {
    let digest = harness.put(&scene.encode().unwrap());
    let inputs = Inputs([(SCENE.to_owned(), digest)].into());
    let stage = MakeDepth::new(DepthParams::default()).unwrap();
    stage.run(&harness.ctx(), &inputs).unwrap()
}

pub(crate) const PLACES: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [1.2, 0.1, 0.2], [0.5, 1.3, 0.0]];

#[test]
fn depths_of_a_plane_are_found_confirmed_and_as_sure_as_they_say() {
    let harness = Harness::default();
    let scene = scene(&harness, &PLACES);
    let outputs = run(&harness, &scene);
    let metrics: Metrics = outputs.read(&harness.ctx()).unwrap();
    assert_eq!(metrics.pairs.len(), 3, "{:?}", metrics.refused);
    assert!(
        metrics.share > 0.8 && metrics.confirmed_share > 0.7,
        "{metrics:?}"
    );
    assert!(
        metrics.map.is_some() && metrics.points > 1000,
        "{:?}",
        metrics.missing
    );
    for (frame, photo) in scene.frames.iter().zip(&metrics.photos) {
        let read = |folder: &str, quantity: &str| {
            let png = harness
                .get(&outputs[&format!("{folder}/{}.png", photo.name)])
                .unwrap();
            read_quantity(&png, quantity).unwrap().2
        };
        let (inverse, sigma) = (read("inverse-depth", "inverse-depth"), read("sigma", "sigma"));
        let (mut errors, mut sure) = (Vec::new(), 0);
        for (index, inverse) in inverse.iter().enumerate().filter(|(_, inverse)| **inverse > 0.0) {
            let at = Vector2::new((index % 160) as f64 + 0.5, (index / 160) as f64 + 0.5);
            let point = on_plane(&frame.camera, &frame.cam_from_world, &at);
            // The unit is 2 m.
            let truth = 0.5 / frame.cam_from_world.point(&point).z;
            let error = (f64::from(*inverse) - truth).abs();
            sure += usize::from(error <= 3.0 * f64::from(sigma[index]));
            errors.push(error / truth);
        }
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        assert!(median < 0.005, "{}: {median}", photo.name);
        assert!(
            sure as f64 > 0.97 * errors.len() as f64,
            "{}: {sure} of {}",
            photo.name,
            errors.len()
        );
    }
}

/// Checks that the median is right to half a per cent, and that 97 % are within three standard deviations.
fn are_of_the_plane(frame: &Frame, distances: &[DistanceSample]) {
    let mut sure = 0;
    let errors = distances.iter().map(|one| {
        let at = Vector2::new(160.0 * f64::from(one.at[0]), 120.0 * f64::from(one.at[1]));
        let truth =
            (on_plane(&frame.camera, &frame.cam_from_world, &at) - frame.cam_from_world.centre()).norm();
        let error = (f64::from(one.distance) - truth).abs();
        sure += usize::from(error <= 3.0 * f64::from(one.sigma));
        error / truth
    });
    let mut errors: Vec<f64> = errors.collect();
    errors.sort_by(f64::total_cmp);
    assert!(errors[errors.len() / 2] < 0.005, "{}", errors[errors.len() / 2]);
    assert!(
        sure as f64 > 0.97 * errors.len() as f64,
        "{sure} of {}",
        errors.len()
    );
}

#[test]
fn distances_of_pixels_are_those_of_the_plane_and_as_sure_as_they_say() {
    let harness = Harness::default();
    let scene = scene(&harness, &PLACES);
    // All of 160 x 120 pixels, or those of every second row and column.
    for (detail, [least, most]) in [
        (TargetDetail::Fine, [12_000, 19_200]),
        (TargetDetail::Coarse, [2_500, 4_800]),
    ] {
        let found = crate::distances(&harness.ctx(), &scene, detail).unwrap();
        assert_eq!(found.len(), 3);
        for (frame, distances) in scene.frames.iter().zip(&found) {
            let count = distances.len();
            assert!((least..=most).contains(&count), "{detail:?}: {count}");
            are_of_the_plane(frame, distances);
        }
    }
    let alone = Scene {
        frames: scene.frames[..1].to_vec(),
        ..scene
    };
    assert_eq!(
        crate::distances(&harness.ctx(), &alone, TargetDetail::Fine).unwrap(),
        [vec![]]
    );
}

#[test]
fn what_is_transparent_has_no_distance() {
    let harness = Harness::default();
    let mut scene = scene(&harness, &PLACES);
    for frame in &mut scene.frames {
        let shown = marf_scene::Photo::decode(&harness.get(&frame.image).unwrap())
            .unwrap()
            .image;
        let cut = image::RgbaImage::from_fn(160, 120, |column, row| {
            let [r, g, b] = shown.at(column, row);
            image::Rgba([r, g, b, if column < 80 { 0 } else { 255 }])
        });
        let mut png = std::io::Cursor::new(Vec::new());
        cut.write_to(&mut png, image::ImageFormat::Png).unwrap();
        frame.image = harness.put(png.get_ref());
    }
    for distances in crate::distances(&harness.ctx(), &scene, TargetDetail::Fine).unwrap() {
        let clear = distances.iter().filter(|one| one.at[0] < 0.5).count();
        assert_eq!(clear, 0);
        assert!(distances.len() > 2_000, "{}", distances.len());
    }
}

#[test]
fn results_are_equal_for_any_threads_and_from_kept_pairs() {
    let on = |threads: usize, harness: &Harness| {
        let scene = scene(harness, &PLACES);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| run(harness, &scene))
    };
    let (one, three) = (Harness::default(), Harness::default());
    let first = on(1, &one);
    assert_eq!(first, on(3, &three));
    assert_eq!(first, on(2, &three), "from kept pairs");
    assert!(first.contains_key(POINTS) && first.contains_key("map/height.tif"));
}

#[test]
fn photos_of_one_place_have_no_depth_and_the_reason() {
    let harness = Harness::default();
    let scene = scene(&harness, &[[0.0; 3], [0.01, 0.0, 0.0]]);
    let outputs = run(&harness, &scene);
    let metrics: Metrics = outputs.read(&harness.ctx()).unwrap();
    assert_eq!((metrics.share, metrics.points), (0.0, 0));
    for photo in &metrics.photos {
        assert!(
            photo.reason.contains("a rotation alone shows no depth"),
            "{}",
            photo.reason
        );
    }
    assert!(
        metrics.missing["map/"].contains("no photo shows a surface"),
        "{:?}",
        metrics.missing
    );
}

/// Returns the reason of the second photo of two, which look at one place 10 units away.
fn reason(place: [f64; 3], turned_away: bool) -> String {
    let harness = Harness::default();
    let mut scene = scene(&harness, &[[0.0; 3], place]);
    if turned_away {
        let to = Vector3::new(0.0, 0.0, -10.0);
        scene.frames[1].cam_from_world = Pose::looking_at(Vector3::from(place), to, Vector3::y());
    }
    let metrics: Metrics = run(&harness, &scene).read(&harness.ctx()).unwrap();
    metrics.photos[1].reason.clone()
}

#[test]
fn a_photo_without_depth_has_the_limit_that_it_missed() {
    // To a point 10 units away: atan(5 / 10) is 26.6 degrees, atan(6.5 / 10) 33.0.
    assert_eq!(reason([5.0, 0.0, 0.0], false), "");
    assert_eq!(
        reason([6.5, 0.0, 0.0], false),
        "the photos look from directions more than 30 degrees apart"
    );
    assert_eq!(reason([1.2, 0.0, 0.0], true), "no other photo shows the same");
}

#[test]
fn a_photo_of_another_size_than_its_camera_stops_the_stage_with_both() {
    let harness = Harness::default();
    let mut scene = scene(&harness, &PLACES);
    scene.frames[1].mask = Some(harness.put(&encode_png(&Image::from_fn(80, 60, |_, _| [255; 3])).unwrap()));
    let digest = harness.put(&scene.encode().unwrap());
    let inputs = Inputs([(SCENE.to_owned(), digest)].into());
    let stage = MakeDepth::new(DepthParams::default()).unwrap();
    let error = stage.run(&harness.ctx(), &inputs).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the mask of `1`: 80 x 60 pixels, its camera has 160 x 120"
    );
}

/// The texts of a PNG are stored as they are.
pub(crate) fn has_text(png: &[u8], text: &str) -> bool {
    png.windows(text.len()).any(|window| window == text.as_bytes())
}

#[test]
fn pictures_say_what_their_values_are() {
    let harness = Harness::default();
    let mut scene = scene(&harness, &PLACES);
    let png = |outputs: &Outputs, folder: &str| harness.get(&outputs[&format!("{folder}/0.png")]).unwrap();
    let outputs = run(&harness, &scene);
    let metrics: Metrics = outputs.read(&harness.ctx()).unwrap();
    let class = png(&outputs, "class");
    assert!(has_text(
        &class,
        "0 none, 1 one pair, 2 confirmed by two, 3 next to an edge, 4 none: pairs differ, 5 none: sky"
    ));
    let mut counts = [0_u32; 6];
    for value in classes(&class) {
        counts[usize::from(value)] += 1;
    }
    let of_all = |count: u32| f64::from(count) / f64::from(160 * 120);
    assert_eq!(of_all(counts[2]), metrics.photos[0].confirmed_share);
    assert_eq!(of_all(counts[1] + counts[2] + counts[3]), metrics.photos[0].share);
    assert_eq!(of_all(counts[4]), metrics.photos[0].differing_share);
    assert_eq!(of_all(counts[5]), metrics.photos[0].sky_share);
    assert!(has_text(&png(&outputs, "inverse-depth"), "1/metre"));
    // Without a scale the unit is that of the scene: 2 m before.
    let largest = |outputs: &Outputs| {
        let read = read_quantity(&png(outputs, "inverse-depth"), "inverse-depth")
            .unwrap()
            .2;
        read.into_iter().fold(0.0, f32::max)
    };
    scene.metres_per_unit = None;
    let bare = run(&harness, &scene);
    assert!(has_text(
        &png(&bare, "inverse-depth"),
        "1/unit of the scene, whose scale is not known"
    ));
    let ratio = largest(&bare) / largest(&outputs);
    assert!((ratio - 2.0).abs() < 1e-3, "{ratio}");
}

pub(crate) fn classes(png: &[u8]) -> Vec<u16> {
    let picture = image::load_from_memory(png).unwrap();
    picture.as_luma16().unwrap().as_raw().clone()
}

#[test]
fn distances_along_the_ray_are_those_to_the_plane() {
    let harness = Harness::default();
    let scene = scene(&harness, &PLACES);
    let outputs = run(&harness, &scene);
    let (png, frame) = (harness.get(&outputs["depth/0.png"]).unwrap(), &scene.frames[0]);
    assert!(has_text(&png, "distance along the ray of a pixel; 0: none"));
    let mut errors: Vec<f64> = Vec::new();
    for (index, distance) in read_quantity(&png, "depth").unwrap().2.into_iter().enumerate() {
        let at = Vector2::new((index % 160) as f64 + 0.5, (index / 160) as f64 + 0.5);
        let point = on_plane(&frame.camera, &frame.cam_from_world, &at);
        // The unit is 2 m.
        let truth = 2.0 * (point - frame.cam_from_world.centre()).norm();
        if distance > 0.0 {
            errors.push((f64::from(distance) / truth - 1.0).abs());
        }
    }
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    assert!(
        errors.len() > 160 * 120 / 2 && median < 0.005,
        "{} of {median}",
        errors.len()
    );
}

/// The right eye: 0.24 m from the left one, where the unit is 0.2 m.
const EYE: [f64; 3] = [1.2, 0.0, 0.0];

fn right_eye(harness: &Harness, focal_px: f64) -> Frame {
    let pose = Pose {
        translation: -Vector3::from(EYE),
        ..Pose::identity()
    };
    photo(harness, 1, pose, focal_px)
}

/// Changes the right one of two parallel eyes whose labels place them, and returns the metrics.
fn twins(change: impl Fn(&Harness, &mut Scene)) -> Metrics {
    let harness = Harness::default();
    let mut scene = scene(&harness, &[[0.0; 3], EYE]);
    scene.points.clear();
    scene.metres_per_unit = Some(0.2);
    scene.frames[1] = right_eye(&harness, 160.0);
    change(&harness, &mut scene);
    run(&harness, &scene).read(&harness.ctx()).unwrap()
}

/// Turns a camera about its columns, as a mast that nods between the eyes.
fn nod(scene: &mut Scene, degrees: f64) {
    let turn = *nalgebra::Rotation3::from_euler_angles(degrees.to_radians(), 0.0, 0.0).matrix();
    let pose = &mut scene.frames[1].cam_from_world;
    (pose.rotation, pose.translation) = (turn * pose.rotation, turn * pose.translation);
}

#[test]
fn twins_of_labels_have_depth_and_rows_that_are_off_are_fitted() {
    let exact = twins(|_, _| {});
    assert!(exact.share > 0.5, "{exact:?}");
    assert_eq!(exact.pairs[0].rows, None);
    // 0.4 degrees at 160 px are 1.1 px.
    let fitted = twins(|_, scene| nod(scene, 0.4));
    let rows = fitted.pairs[0].rows.unwrap();
    assert!((rows.offset_px.abs() - 1.1).abs() < 0.3, "{rows:?}");
    assert!(fitted.share > 0.5, "{fitted:?}");
    let zoom = twins(|harness, scene| scene.frames[1] = right_eye(harness, 320.0));
    assert_eq!(zoom.pairs[0].reason, "");
    assert!(zoom.photos[1].share > 0.3, "{zoom:?}");
}

#[test]
fn a_pair_that_gives_no_depth_has_one_sentence_and_so_have_its_photos() {
    let burnt_out = twins(|harness, scene| {
        let image = Image::from_fn(160, 120, |_, _| [255; 3]);
        scene.frames[1].image = harness.put(&encode_png(&image).unwrap());
    });
    let hidden = twins(|harness, scene| {
        let mask = Image::from_fn(160, 120, |_, _| [0; 3]);
        scene.frames[1].mask = Some(harness.put(&encode_png(&mask).unwrap()));
    });
    let exchanged = twins(|_, scene| {
        let [left, right] = [0, 1].map(|index| scene.frames[index].image);
        (scene.frames[0].image, scene.frames[1].image) = (right, left);
    });
    let moved = twins(|_, scene| nod(scene, 1.2));
    for (metrics, reason) in [
        (
            burnt_out,
            "0.0 % of the rectified right photo can be used: the rest is masked, black, burnt out",
        ),
        (hidden, "0.0 % of the rectified right photo can be used"),
        (exchanged, "Exchange the pictures"),
        (
            moved,
            "and the limit is 0.5: the mast moved between the photos, or a camera is wrong",
        ),
    ] {
        assert!(
            metrics.pairs[0].reason.contains(reason),
            "{reason}: {:?}",
            metrics.pairs
        );
        for photo in &metrics.photos {
            assert_eq!(
                (photo.share, &photo.reason),
                (0.0, &metrics.pairs[0].reason),
                "{reason}"
            );
        }
    }
}

#[test]
fn a_twin_of_four_times_the_zoom_is_refused_with_the_limit() {
    let metrics = twins(|harness, scene| scene.frames[1] = right_eye(harness, 640.0));
    assert_eq!(
        metrics.photos[1].reason,
        "the photos show the same at sizes that differ by more than a factor of 3.5"
    );
}
