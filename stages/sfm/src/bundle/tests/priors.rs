use nalgebra::Vector3;

use super::super::synthetic::add_noise;
use super::*;

fn centre(pose: u32, exact: &Problem, sigma: f64) -> Prior {
    Prior::Centre {
        pose,
        centre: exact.poses[pose as usize].centre(),
        sigma,
    }
}

/// The exact problem with all poses free.
fn free() -> Problem {
    let mut problem = ring(&SMALL);
    problem.pose_freedom.fill(PoseFreedom::Free);
    problem
}

#[test]
fn centres_fix_place_and_scale() {
    let exact = free();
    let mut problem = perturbed(&exact, 0.02, 0.05);
    problem.priors = (0..12).map(|pose| centre(pose, &exact, 0.01)).collect();
    run(&mut problem, &EXACT);
    let (angle, centre) = distance(&problem.poses, &exact.poses);
    assert!(angle < 1e-9 && centre < 1e-9, "{angle} {centre}");
}

#[test]
fn one_attitude_one_centre_and_one_baseline_fix_the_frame() {
    let exact = free();
    let mut problem = perturbed(&exact, 0.02, 0.05);
    problem.priors = vec![
        centre(4, &exact, 0.01),
        Prior::Attitude {
            pose: 4,
            cam_from_world: exact.poses[4],
            sigma_rad: 0.01,
        },
        Prior::Relative {
            pose_1: 7,
            pose_2: 5,
            cam2_from_cam1: exact.poses[5] * exact.poses[7].inverse(),
            sigma_rad: 0.01,
            sigma: 0.001,
        },
    ];
    run(&mut problem, &EXACT);
    let (angle, centre) = distance(&problem.poses, &exact.poses);
    assert!(angle < 1e-8 && centre < 1e-8, "{angle} {centre}");
}

#[test]
fn a_prior_alone_moves_a_pose_that_sees_nothing() {
    let mut problem = free();
    problem.observations.clear();
    problem.camera_freedom[0].focal = true;
    let target = Vector3::new(3.0, 2.0, 1.0);
    problem.priors = vec![
        Prior::Centre {
            pose: 3,
            centre: target,
            sigma: 0.1,
        },
        Prior::Focal {
            camera: 0,
            focal_px: 700.0,
            sigma_share: 0.01,
        },
    ];
    let before = problem.clone();
    run(&mut problem, &EXACT);
    assert!((problem.poses[3].centre() - target).norm() < 1e-10);
    assert!((problem.cameras[0].fx_px - 700.0).abs() < 1e-7);
    assert_eq!(problem.poses[4], before.poses[4]);
}

#[test]
fn a_focal_prior_and_the_observations_meet_by_their_weights() {
    let exact = ring(&SMALL);
    let with_sigma = |sigma_share| {
        let mut problem = exact.clone();
        add_noise(&mut problem, 0.5, &mut Rng::new(3));
        problem.priors = vec![Prior::Focal {
            camera: 0,
            focal_px: 800.0,
            sigma_share,
        }];
        run(&mut problem, &EXACT);
        problem.cameras[0].fx_px
    };
    let (hard, soft) = (with_sigma(1e-7), with_sigma(10.0));
    assert!((hard - 800.0).abs() < 0.1, "{hard}");
    assert!((soft - 726.5).abs() < 5.0, "{soft}");
}

#[test]
fn a_wrong_prior_is_outvoted_under_cauchy() {
    let exact = free();
    let mut problem = perturbed(&exact, 0.01, 0.02);
    problem.priors = (0..12).map(|pose| centre(pose, &exact, 0.01)).collect();
    if let Some(Prior::Centre { centre, .. }) = problem.priors.get_mut(6) {
        *centre += Vector3::new(1.5, -2.0, 1.0);
    }
    let robust = BundleOptions {
        prior_loss: Loss::Cauchy(2.0),
        ..EXACT
    };
    run(&mut problem, &robust);
    let (angle, centre) = distance(&problem.poses, &exact.poses);
    assert!(angle < 1e-3 && centre < 2e-3, "{angle} {centre}");
}
