//! Scenes of the demo tied by what their photos show.

use std::sync::OnceLock;

use marf_calibrate::TieScenes;
use marf_demo::Demo;
use marf_scene::{Pose, Scene};
use marf_schema::output::SCENE;
use marf_schema::ties::{By, SceneTie, Ties};
use marf_stage::{Document, Inputs, StageDef, Work, define};
use nalgebra::{Matrix3, Vector3};
use serde_json::json;

use super::{demo, labelled, small};
use crate::common::Input;

/// Two sols of one place, calibrated apart, and a place of another site.
struct Places {
    input: Input,
    /// The true pose of each photo of the first place, by file.
    truth: Vec<(String, Pose)>,
    first: Scene,
    second: Scene,
    elsewhere: Scene,
}

fn places() -> &'static Places {
    static PLACES: OnceLock<Places> = OnceLock::new();
    PLACES.get_or_init(|| {
        let (mut input, truth) = demo();
        let calibrated = |input: &Input| input.run(&json!({"method": "sfm"})).unwrap().scene;
        let later = input.split_off(8);
        let first = calibrated(&input);
        input.split_off(0);
        input.add(later);
        let second = calibrated(&input);
        let demo = Demo::new(small()).unwrap();
        let files = demo.files(101, &|_, _| (), &|| false).unwrap();
        input.split_off(0);
        for photo in demo.ground_truth(101).unwrap().photos {
            let (id, bytes, facts) = labelled(&files, &photo.file);
            input.photo(&id, &bytes, facts);
        }
        let elsewhere = calibrated(&input);
        Places {
            input,
            truth,
            first,
            second,
            elsewhere,
        }
    })
}

impl Places {
    /// The stage `ties` on scenes by name.
    fn ties(&self, scenes: &[(&str, &Scene)]) -> Ties {
        const STAGE: StageDef = define::<TieScenes>();
        let stage = (STAGE.bind)(json!({})).unwrap();
        let Work::Set(set) = stage.work() else {
            unreachable!()
        };
        let harness = &self.input.harness;
        let stored = scenes.iter().map(|(name, scene)| {
            let digest = harness.put(&scene.encode().unwrap());
            (format!("{SCENE}/calibrate@{name}"), digest)
        });
        let outputs = set.run(&harness.ctx(), &Inputs(stored.collect())).unwrap();
        Ties::decode(&harness.get(&outputs[Ties::OUTPUT]).unwrap()).unwrap()
    }

    fn true_centre(&self, file: &str) -> Vector3<f64> {
        let (_, pose) = self.truth.iter().find(|(of, _)| of == file).unwrap();
        pose.centre()
    }

    /// How far labels put a scene from its true place.
    fn label_error(&self, scene: &Scene) -> Vector3<f64> {
        let origin = Vector3::from(scene.site.unwrap().origin_m);
        let errors = scene
            .frames
            .iter()
            .map(|frame| frame.cam_from_world.centre() + origin - self.true_centre(&frame.file));
        errors.sum::<Vector3<f64>>() / scene.frames.len() as f64
    }
}

/// A scene that no label places, with an arbitrary unit and axes.
fn without_labels(scene: &Scene) -> Scene {
    let mut free = scene.clone();
    (free.site, free.metres_per_unit, free.up) = (None, None, None);
    let turn = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    for frame in &mut free.frames {
        let Pose {
            rotation,
            translation,
        } = frame.cam_from_world;
        frame.cam_from_world = Pose {
            rotation: rotation * turn.transpose(),
            translation: translation * 3.0,
        };
    }
    for point in &mut free.points {
        point.position = (turn * Vector3::from(point.position) * 3.0).into();
    }
    free
}

/// Error of the labels of a scene: photos of 480 pixels do not show that of the demo, 0.014 m.
const PLANTED_M: f64 = 0.5;

#[test]
fn two_scenes_of_a_site_are_told_how_far_labels_are_from_what_they_show() {
    let places = places();
    let (first, mut second) = (&places.first, places.second.clone());
    second.site.as_mut().unwrap().origin_m[0] += PLANTED_M;
    let second = &second;
    let told = places.ties(&[("a", first), ("b", second)]);
    let [tie] = told.ties.as_slice() else {
        panic!("{told:?}")
    };
    let SceneTie {
        points,
        inliers,
        median_px,
        ..
    } = tie;
    println!(
        "{inliers} of {points} points, {median_px} px, {:?} m",
        tie.median_m
    );
    let gap = tie.labels.unwrap();
    let expected = places.label_error(second) - places.label_error(first);
    let off_m = (Vector3::from(gap.shift_m) - expected).norm();
    assert!(off_m < 0.1 * PLANTED_M, "{off_m} m of {} m", expected.norm());
    assert!(gap.angle_deg < 0.2 && (gap.scale - 1.0).abs() < 0.01, "{gap:?}");
    assert!(*median_px < 2.0 && tie.median_m.unwrap() < 0.05, "{tie:?}");
    let frames: Vec<(&str, By)> = told
        .scenes
        .iter()
        .map(|one| (one.frame.as_str(), one.by))
        .collect();
    assert_eq!(frames, [("site 1", By::Labels); 2]);
}

#[test]
fn a_scene_that_no_label_places_lies_where_the_ground_it_shares_is() {
    let places = places();
    let free = without_labels(&places.second);
    let told = places.ties(&[("a", &places.first), ("b", &free)]);
    let [_, of_b] = told.scenes.as_slice() else {
        panic!("{told:?}")
    };
    assert_eq!((of_b.frame.as_str(), of_b.by), ("site 1", By::Overlap));
    assert_eq!(of_b.through, ["a"]);
    let to_site = &of_b.frame_from_world;
    assert!((to_site.scale * 3.0 - 1.0).abs() < 0.01, "{to_site:?}");
    let rotation = Matrix3::from_fn(|row, column| to_site.rotation[row][column]);
    for frame in &free.frames {
        let centre = rotation * frame.cam_from_world.centre() * to_site.scale;
        let off_m = (centre + Vector3::from(to_site.translation) - places.true_centre(&frame.file)).norm();
        assert!(off_m < 0.07, "{}: {off_m} m", frame.file);
    }
}

/// Ground of the same kind elsewhere looks alike. A scene without points shows nothing.
#[test]
fn nothing_but_shared_ground_ties_scenes() {
    let places = places();
    let told = places.ties(&[("a", &places.first), ("c", &places.elsewhere)]);
    let compared = (told.ties.len(), told.apart.len());
    assert_eq!(compared, (0, 0), "sites that share no frame: {told:?}");
    let elsewhere = without_labels(&places.elsewhere);
    let told = places.ties(&[("a", &places.first), ("c", &elsewhere)]);
    println!("{:?}", told.apart);
    assert_eq!(told.ties, [], "{told:?}");
    let of_c = &told.scenes[1];
    assert_eq!((of_c.by, of_c.frame.as_str()), (By::Itself, "c"));
    let mut bare = without_labels(&places.second);
    bare.points.clear();
    let told = places.ties(&[("a", &places.first), ("b", &bare)]);
    assert_eq!(told.apart[0].reason, "`b` has no sparse points");
}
