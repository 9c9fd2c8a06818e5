//! Residuals of priors, in sigmas, and their derivatives.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::problem::Prior;
use super::so3;
use super::state::State;

/// Returns the residual of a prior, unused rows zero.
pub(super) fn error(prior: &Prior, state: &State) -> Vector6<f64> {
    let stacked = |upper: Vector3<f64>, lower: Vector3<f64>| {
        Vector6::new(upper.x, upper.y, upper.z, lower.x, lower.y, lower.z)
    };
    match *prior {
        Prior::Centre { pose, centre, sigma } => {
            let offset = state.views[pose as usize].centre - centre;
            stacked(offset / sigma, Vector3::zeros())
        }
        Prior::Attitude { sigma_rad, .. } => {
            stacked(attitude_error(prior, state) / sigma_rad, Vector3::zeros())
        }
        Prior::Relative {
            cam2_from_cam1,
            sigma_rad,
            sigma,
            ..
        } => {
            let (_, baseline) = relative(prior, state);
            let offset = baseline - cam2_from_cam1.translation;
            stacked(attitude_error(prior, state) / sigma_rad, offset / sigma)
        }
        Prior::Focal {
            camera,
            focal_px,
            sigma_share,
        } => {
            let share = libm::log(state.cameras[camera as usize].fx_px / focal_px);
            Vector6::x() * (share / sigma_share)
        }
    }
}

/// Number of residuals of a prior.
pub(super) fn count(prior: &Prior) -> usize {
    match prior {
        Prior::Centre { .. } | Prior::Attitude { .. } => 3,
        Prior::Relative { .. } => 6,
        Prior::Focal { .. } => 1,
    }
}

/// Returns the derivatives of `error` by rotation and centre of the prior's one or two poses.
pub(super) fn jacobians(prior: &Prior, state: &State) -> [Matrix6<f64>; 2] {
    let mut jacobians = [Matrix6::zeros(); 2];
    let mut set = |which: usize, row: usize, column: usize, block: Matrix3<f64>| {
        jacobians[which]
            .fixed_view_mut::<3, 3>(row, column)
            .copy_from(&block);
    };
    match *prior {
        Prior::Centre { sigma, .. } => set(0, 0, 3, Matrix3::identity() / sigma),
        Prior::Attitude { sigma_rad, .. } => {
            set(
                0,
                0,
                0,
                so3::log_jacobian(&attitude_error(prior, state)) / sigma_rad,
            );
        }
        Prior::Relative {
            pose_2,
            sigma_rad,
            sigma,
            ..
        } => {
            let (rotation, baseline) = relative(prior, state);
            let by_rotation = so3::log_jacobian(&attitude_error(prior, state)) / sigma_rad;
            set(0, 0, 0, -by_rotation * rotation);
            set(1, 0, 0, by_rotation);
            set(1, 3, 0, -baseline.cross_matrix() / sigma);
            let by_centre = state.views[pose_2 as usize].rotation / sigma;
            set(0, 3, 3, by_centre);
            set(1, 3, 3, -by_centre);
        }
        Prior::Focal { .. } => {}
    }
    jacobians
}

/// Returns the rotation vector from the expected attitude to the current one, radian.
fn attitude_error(prior: &Prior, state: &State) -> Vector3<f64> {
    let (found, expected) = match prior {
        Prior::Attitude {
            pose, cam_from_world, ..
        } => (
            state.views[*pose as usize].rotation,
            so3::orthonormal(&cam_from_world.rotation),
        ),
        Prior::Relative { cam2_from_cam1, .. } => (
            relative(prior, state).0,
            so3::orthonormal(&cam2_from_cam1.rotation),
        ),
        Prior::Centre { .. } | Prior::Focal { .. } => return Vector3::zeros(),
    };
    so3::log(&(found * expected.transpose()))
}

/// Returns rotation and translation of `cam2_from_cam1`: R2 R1ᵀ and R2 (C1 - C2).
fn relative(prior: &Prior, state: &State) -> (Matrix3<f64>, Vector3<f64>) {
    let Prior::Relative { pose_1, pose_2, .. } = *prior else {
        return (Matrix3::identity(), Vector3::zeros());
    };
    let (first, second) = (&state.views[pose_1 as usize], &state.views[pose_2 as usize]);
    (
        second.rotation * first.rotation.transpose(),
        second.rotation * (first.centre - second.centre),
    )
}
