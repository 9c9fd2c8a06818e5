use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2, Vector3, Vector6};

use super::super::index::Index;
use super::super::residual::{CameraParam, CentredPose, project};
use super::super::state::{CameraBounds, Normalization, State, Step};
use super::super::synthetic::vector;
use super::super::{priors as prior_residuals, so3};
use super::*;

const STEP: f64 = 1e-6;
/// Pixels per unit: derivatives here reach some 1e3, differences of 1e-6 leave 1e-7 of that.
const TOLERANCE: f64 = 2e-4;

fn lens() -> Camera {
    Camera {
        fy_px: 731.0,
        k1: 0.09,
        k2: -0.13,
        p1: 0.002,
        p2: -0.003,
        ..Camera::pinhole(720, 960, 726.0)
    }
}

fn axis(axis: usize, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|row, _| if row == axis { size } else { 0.0 })
}

fn error(view: &CentredPose, camera: &Camera, point: &Vector3<f64>) -> Vector2<f64> {
    project(view, camera, point)
        .unwrap()
        .error(camera, &Vector2::new(300.0, 500.0))
        .into()
}

/// Central difference of a function of one number.
fn difference(f: impl Fn(f64) -> Vector2<f64>) -> Vector2<f64> {
    (f(STEP) - f(-STEP)) / (2.0 * STEP)
}

fn assert_close(what: &str, found: [f64; 2], wanted: Vector2<f64>) {
    let off = (Vector2::from(found) - wanted).norm();
    assert!(off < TOLERANCE, "{what}: {found:?}, difference quotient {wanted}");
}

/// Points well in front and within the fold: no kink is near.
fn cases() -> Vec<(CentredPose, Vector3<f64>)> {
    let mut rng = Rng::new(3);
    let case = |_| {
        let view = CentredPose {
            rotation: so3::exp(&vector(&mut rng, 1.5)),
            centre: vector(&mut rng, 2.0),
        };
        let seen = Vector3::new(
            1.2 * rng.unit_f64() - 0.6,
            rng.unit_f64() - 0.5,
            1.5 + rng.unit_f64(),
        );
        let point = view.rotation.transpose() * seen + view.centre;
        (view, point)
    };
    (0..20).map(case).collect()
}

#[test]
fn derivatives_by_pose_and_point_agree_with_central_differences() {
    let camera = lens();
    for (view, point) in cases() {
        let row = project(&view, &camera, &point)
            .unwrap()
            .row(&view, &camera, [0.0; 2], 1.0);
        for k in 0..3 {
            let by_point = difference(|h| error(&view, &camera, &(point + axis(k, h))));
            assert_close("point", [row.point[0][k], row.point[1][k]], by_point);
            let moved = |h| CentredPose {
                centre: view.centre + axis(k, h),
                ..view
            };
            let by_centre = difference(|h| error(&moved(h), &camera, &point));
            assert_close("centre", [-row.point[0][k], -row.point[1][k]], by_centre);
            let turned = |h| CentredPose {
                rotation: so3::exp(&axis(k, h)) * view.rotation,
                ..view
            };
            let by_turn = difference(|h| error(&turned(h), &camera, &point));
            assert_close("turn", [row.rotation[0][k], row.rotation[1][k]], by_turn);
        }
    }
}

#[test]
fn derivatives_by_every_term_of_the_lens_agree_with_central_differences() {
    use CameraParam::{Cx, Cy, Focal, K1, K2, P1, P2};
    let camera = lens();
    let terms = [Focal, K1, K2, P1, P2, Cx, Cy];
    let moved = |term: CameraParam, h: f64| {
        let mut camera = camera;
        match term {
            Focal => {
                camera.fx_px *= h.exp();
                camera.fy_px *= h.exp();
            }
            K1 => camera.k1 += h,
            K2 => camera.k2 += h,
            P1 => camera.p1 += h,
            P2 => camera.p2 += h,
            Cx => camera.cx_px += h,
            Cy => camera.cy_px += h,
        }
        camera
    };
    for (view, point) in cases() {
        let row = project(&view, &camera, &point)
            .unwrap()
            .camera_jacobian(&camera, &terms, 1.0);
        for (column, &term) in terms.iter().enumerate() {
            let slope = difference(|h| error(&view, &moved(term, h), &point));
            assert_close(&format!("{term:?}"), [row[0][column], row[1][column]], slope);
        }
    }
}

/// Two poses, one prior of each kind, all residuals away from zero.
fn with_priors() -> Problem {
    let mut rng = Rng::new(9);
    let mut problem = ring(&SMALL);
    let (one, two) = (problem.poses[2], problem.poses[3]);
    let mut bent = |pose: Pose| {
        let rotation = so3::exp(&vector(&mut rng, 0.4)) * pose.rotation;
        Pose {
            rotation,
            translation: pose.translation + vector(&mut rng, 0.5),
        }
    };
    problem.priors = vec![
        Prior::Centre {
            pose: 2,
            centre: bent(one).centre(),
            sigma: 0.3,
        },
        Prior::Attitude {
            pose: 2,
            cam_from_world: bent(one),
            sigma_rad: 0.2,
        },
        Prior::Relative {
            pose_1: 2,
            pose_2: 3,
            cam2_from_cam1: bent(two * one.inverse()),
            sigma_rad: 0.1,
            sigma: 0.7,
        },
        Prior::Focal {
            camera: 0,
            focal_px: 800.0,
            sigma_share: 0.05,
        },
    ];
    problem
}

#[test]
fn derivatives_of_every_prior_agree_with_central_differences() {
    let problem = with_priors();
    let normalization = Normalization::new(&problem);
    let index = Index::new(&problem);
    let camera_bounds = [CameraBounds::new(&problem.cameras[0])];
    let state = State::new(&problem, &normalization);
    let moved = |unknown: usize, h: f64| {
        let mut step = Step {
            reduced: vec![0.0; index.unknowns()],
            points: vec![Vector3::zeros(); problem.points.len()],
        };
        step.reduced[unknown] = h;
        let mut to = state.clone();
        to.set_stepped(&state, &step, &index, &camera_bounds);
        to
    };
    for prior in problem.priors.iter().map(|prior| normalization.prior(prior)) {
        let slope = |unknown: usize| -> Vector6<f64> {
            (prior_residuals::error(&prior, &moved(unknown, STEP))
                - prior_residuals::error(&prior, &moved(unknown, -STEP)))
                / (2.0 * STEP)
        };
        if let Prior::Focal { sigma_share, .. } = prior {
            assert!((slope(0).x - 1.0 / sigma_share).abs() < 1e-7, "{prior:?}");
            continue;
        }
        for (which, pose) in [(0, 2), (1, 3)] {
            let at = index.pose_at(index.slot_of_pose[pose] as usize);
            let slopes = prior_residuals::jacobians(&prior, &state)[which];
            for term in 0..6 {
                let off = (slopes.column(term) - slope(at + term)).norm();
                assert!(off < 1e-7, "{prior:?}, pose {which}, term {term}: {off}");
            }
        }
    }
}

#[test]
fn the_inside_projects_as_the_camera_does() {
    for camera in [
        lens(),
        Camera {
            k1: -0.4,
            k2: 0.05,
            ..lens()
        },
        Camera::pinhole(100, 50, 80.0),
    ] {
        for k in 0..400 {
            let seen = Vector3::new(f64::from(k) * 0.01 - 2.0, 0.3, 1.0 - f64::from(k % 7) * 0.2);
            let view = CentredPose {
                rotation: Matrix3::identity(),
                centre: Vector3::zeros(),
            };
            let inside = project(&view, &camera, &seen).map(|s| s.error(&camera, &Vector2::zeros()));
            let outside = camera.project(&seen);
            assert_eq!(inside.is_some(), outside.is_some(), "{camera:?} {seen}");
            if let (Some(inside), Some(outside)) = (inside, outside) {
                assert!((Vector2::from(inside) - outside).norm() < 1e-9 * outside.norm().max(1.0));
            }
        }
    }
}
