use nalgebra::{Matrix6, Vector6};

use super::super::synthetic::add_noise;
use super::*;
use crate::tests::polls::Polls;

const SOLVES: usize = 200;

fn scene() -> Problem {
    ring(&RingSize {
        poses: 6,
        points: 60,
        longest_track: 6,
        seed: 8,
    })
}

#[test]
fn covariances_agree_with_many_noisy_solves() {
    let exact = scene();
    let sigma_px = 0.7;
    let predicted_gain = pose_covariances(&exact, sigma_px, &|| false).unwrap();
    let mut rng = Rng::new(77);
    let mut found = vec![Matrix6::zeros(); 6];
    for _ in 0..SOLVES {
        let mut problem = exact.clone();
        add_noise(&mut problem, sigma_px, &mut rng);
        run(
            &mut problem,
            &BundleOptions {
                tolerance: 1e-9,
                ..EXACT
            },
        );
        for ((sum, pose), truth) in found.iter_mut().zip(&problem.poses).zip(&exact.poses) {
            let turned = so3::log(&(pose.rotation * truth.rotation.transpose()));
            let moved = pose.centre() - truth.centre();
            let off = Vector6::new(turned.x, turned.y, turned.z, moved.x, moved.y, moved.z);
            *sum += off * off.transpose() / SOLVES as f64;
        }
    }
    assert_eq!(predicted_gain[0], Matrix6::zeros());
    for (pose, (predicted_gain, found)) in predicted_gain.iter().zip(&found).enumerate().skip(1) {
        for term in 0..6 {
            let (wanted, got) = (predicted_gain[(term, term)].sqrt(), found[(term, term)].sqrt());
            // 200 solves determine a sigma to 5 %. The tolerance is four times that.
            assert!(
                (got - wanted).abs() <= 0.2 * wanted + 1e-12,
                "{pose}, {term}: {got}, predicted {wanted}"
            );
        }
    }
}

#[test]
fn a_pose_is_known_better_if_all_else_is_held() {
    let mut problem = scene();
    let all = pose_covariances(&problem, 1.0, &|| false).unwrap();
    problem.pose_freedom.fill(PoseFreedom::Free);
    let own = own_pose_covariances(&problem, 1.0);
    let twice = own_pose_covariances(&problem, 2.0);
    for pose in 2..6 {
        let (own, twice) = (own[pose].unwrap(), twice[pose].unwrap());
        assert!((twice - own * 4.0).norm() < 1e-9 * twice.norm(), "{pose}");
        for term in 0..6 {
            let (held, free) = (own[(term, term)], all[pose][(term, term)]);
            assert!(0.0 < held && held < free, "{pose}, {term}: {held}, {free}");
        }
    }
    problem.observations.retain(|observation| observation.pose != 3);
    assert_eq!(own_pose_covariances(&problem, 1.0)[3], None);
}

#[test]
fn a_free_gauge_has_no_covariance_and_a_prior_gives_it_one() {
    let mut problem = scene();
    problem.pose_freedom.fill(PoseFreedom::Free);
    assert_eq!(pose_covariances(&problem, 1.0, &|| false), None);
    problem.priors = (0..6)
        .map(|pose| Prior::Centre {
            pose,
            centre: problem.poses[pose as usize].centre(),
            sigma: 0.02,
        })
        .collect();
    let covariances = pose_covariances(&problem, 1e-2, &|| false).unwrap();
    // With pixels this good the shape is certain, its place is that of the mean of six centres.
    let trace = covariances[0].fixed_view::<3, 3>(3, 3).trace().sqrt();
    assert!((0.5..3.0).contains(&(trace / (0.02 / 6.0_f64.sqrt()))), "{trace}");
}

#[test]
fn covariance_scales_with_the_world_and_the_square_of_the_noise() {
    let exact = scene();
    let one = pose_covariances(&exact, 1.0, &|| false).unwrap();
    let mut large = exact.clone();
    large.poses.iter_mut().for_each(|pose| pose.translation *= 1e6);
    large.points.iter_mut().for_each(|point| *point *= 1e6);
    let two = pose_covariances(&large, 2.0, &|| false).unwrap();
    for pose in 2..6 {
        assert!((two[pose][(0, 0)] / one[pose][(0, 0)] / 4.0 - 1.0).abs() < 1e-6);
        assert!((two[pose][(4, 4)] / one[pose][(4, 4)] / 4e12 - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_photo_whose_points_nobody_else_sees_has_no_covariance() {
    let mut problem = scene();
    let mut lone = Vec::new();
    problem.observations.retain(|seen| {
        lone.extend((seen.pose == 4).then_some(*seen));
        seen.pose != 4
    });
    for seen in lone {
        let point = problem.points.len() as u32;
        problem.points.push(problem.points[seen.point as usize]);
        problem.observations.push(Observation { point, ..seen });
    }
    assert_eq!(pose_covariances(&problem, 1.0, &|| false), None);
}

/// Polls before anything is factored.
const ASSEMBLY: u64 = 2;
/// Panels of 48 columns.
const PANELS: u64 = 6;
/// Poses that are free: 246 unknowns.
const FREE: u64 = 41;

fn six_panels() -> Problem {
    ring(&RingSize {
        poses: FREE as usize + 1,
        points: 200,
        longest_track: 6,
        seed: 8,
    })
}

#[test]
fn a_stop_has_no_covariances_and_a_panel_and_a_block_poll_once() {
    let problem = six_panels();
    let all = ASSEMBLY + PANELS + FREE;
    for after in 0..all {
        let polls = Polls::new(after);
        let stopped = pose_covariances(&problem, 0.7, &|| polls.stop());
        assert!(stopped.is_none(), "stopped after {after} polls");
    }
    let polls = Polls::new(all);
    assert!(pose_covariances(&problem, 0.7, &|| polls.stop()).is_some());
}
