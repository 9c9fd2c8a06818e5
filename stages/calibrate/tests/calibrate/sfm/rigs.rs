//! Stereo pairs: labels that agree with the photos hold both eyes together, and wrong ones are told apart.

use marf_scene::Pose;
use marf_schema::rigs::Verdict;
use nalgebra::{Rotation3, Vector3};
use serde_json::json;

use super::errors::errors_of;
use super::{demo, solved};
use crate::common::Input;

#[test]
fn a_wrong_relative_pose_of_a_stereo_pair_is_told_apart_and_the_others_are_rigid() {
    let (mut input, truth) = demo();
    let pairs = &solved().1.metrics.stereo_pairs;
    assert!(
        pairs.len() == 20 && pairs.iter().all(|pair| pair.verdict == Verdict::Rigid),
        "{pairs:?}"
    );
    let indices = |pair: usize| pairs[pair].photos.each_ref().map(|id| input.index_of(id));
    let [turned, shortened, swapped] = [3, 8, 14].map(indices);
    input.relabel(turned[1], |prior| {
        let centre = Vector3::from(prior.model.c);
        let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), 1_f64.to_radians()).into_inner();
        prior.model = prior.model.transformed(&Pose {
            rotation,
            translation: centre - rotation * centre,
        });
    });
    shorten(&mut input, shortened[0], shortened[1]);
    let first = input.relabel(swapped[0], |_| {});
    let second = input.relabel(swapped[1], |prior| prior.clone_from(&first));
    input.relabel(swapped[0], |prior| *prior = second);
    let output = input.run(&json!({"method": "sfm"})).unwrap();
    let found = &output.metrics.stereo_pairs;
    for (index, pair) in found.iter().enumerate() {
        let expected = if [3, 8, 14].contains(&index) {
            Verdict::Differs
        } else {
            Verdict::Rigid
        };
        assert_eq!(pair.verdict, expected, "{index}: {pair:?}");
    }
    let errors = errors_of(&output.scene, &truth);
    assert!((errors.scale - 1.0).abs() <= 0.001, "{errors:?}");
}

/// The pairs agree with each other, but not with the positions of the stops.
#[test]
fn stereo_pairs_that_are_all_of_one_wrong_length_are_ignored() {
    let (mut input, truth) = demo();
    for pair in &solved().1.metrics.stereo_pairs {
        let [left, right] = pair.photos.each_ref().map(|id| input.index_of(id));
        shorten(&mut input, left, right);
    }
    let output = input.run(&json!({"method": "sfm"})).unwrap();
    let found = &output.metrics.stereo_pairs;
    assert!(
        found.len() == 20 && found.iter().all(|pair| pair.verdict == Verdict::Differs),
        "{found:?}"
    );
    let errors = errors_of(&output.scene, &truth);
    assert!((errors.scale - 1.0).abs() <= 0.02, "{errors:?}");
}

#[test]
fn two_stereo_pairs_are_too_few_to_be_sure_of_their_length() {
    let (mut input, _) = demo();
    for pair in &solved().1.metrics.stereo_pairs[2..] {
        input.relabel(input.index_of(&pair.photos[0]), |prior| {
            prior.motion_counter.push(7)
        });
    }
    let found = input.run(&json!({"method": "sfm"})).unwrap().metrics.stereo_pairs;
    let verdicts: Vec<Verdict> = found.iter().map(|pair| pair.verdict).collect();
    assert_eq!(verdicts, [Verdict::Unclear; 2]);
}

/// Moves the right eye of the labels to the left one by a fifth of their distance.
fn shorten(input: &mut Input, left: usize, right: usize) {
    let left = input.relabel(left, |_| {});
    input.relabel(right, |prior| {
        let baseline = Vector3::from(left.model.c) - Vector3::from(prior.model.c);
        prior.model = prior.model.transformed(&Pose {
            translation: 0.2 * baseline,
            ..Pose::identity()
        });
    });
}
