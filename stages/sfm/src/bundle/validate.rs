//! Checks of a problem before it is adjusted.

use super::options::BundleOptions;
use super::problem::{Prior, Problem};

/// Reason why a problem was refused. The problem is unchanged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BundleError {
    /// A list has the wrong length.
    #[error("{what}: {found} entries, {wanted} wanted")]
    Length {
        /// The list.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length it should have.
        wanted: usize,
    },
    /// An index is out of range.
    #[error("{what} {index} names {target}, of {count}")]
    Unknown {
        /// The list.
        what: &'static str,
        /// Position in the list.
        index: usize,
        /// The index found there.
        target: u32,
        /// Number of possible targets.
        count: usize,
    },
    /// A number is not finite or out of range.
    #[error("{what} {index} is not valid")]
    Invalid {
        /// The list.
        what: &'static str,
        /// Position in the list.
        index: usize,
    },
    /// Observations are not sorted.
    #[error("observation {index} does not follow the one before by (point, pose)")]
    Order {
        /// Position of the observation.
        index: usize,
    },
    /// The width of a loss is out of range.
    #[error("width of a loss must be in [1e-12, 1e12)")]
    Loss,
}

/// Refuses losses whose width is out of range.
pub(super) fn check_options(options: &BundleOptions) -> Result<(), BundleError> {
    let valid = options.loss.is_valid() && options.prior_loss.is_valid();
    valid.then_some(()).ok_or(BundleError::Loss)
}

/// Refuses lists that do not fit together, indices out of range, numbers that are not finite.
pub(super) fn check(problem: &Problem) -> Result<(), BundleError> {
    check_lengths(problem)?;
    let (cameras, poses) = (problem.cameras.len(), problem.poses.len());
    for (index, &camera) in problem.camera_of_pose.iter().enumerate() {
        known("pose", index, camera, cameras)?;
    }
    all_valid("camera", problem.cameras.iter().map(|camera| camera.is_valid()))?;
    all_valid("pose", problem.poses.iter().map(|pose| pose.is_valid()))?;
    let finite = |point: &nalgebra::Vector3<f64>| point.iter().all(|value| value.is_finite());
    all_valid("point", problem.points.iter().map(finite))?;
    check_observations(problem)?;
    for (index, prior) in problem.priors.iter().enumerate() {
        match *prior {
            Prior::Centre { pose, .. } | Prior::Attitude { pose, .. } => known("prior", index, pose, poses)?,
            Prior::Relative { pose_1, pose_2, .. } => {
                known("prior", index, pose_1, poses)?;
                known("prior", index, pose_2, poses)?;
            }
            Prior::Focal { camera, .. } => known("prior", index, camera, cameras)?,
        }
    }
    all_valid("prior", problem.priors.iter().map(is_valid))
}

/// Refuses lists of different lengths.
fn check_lengths(problem: &Problem) -> Result<(), BundleError> {
    let poses = problem.poses.len();
    let lengths = [
        (
            "camera freedom",
            problem.camera_freedom.len(),
            problem.cameras.len(),
        ),
        ("pose freedom", problem.pose_freedom.len(), poses),
        ("camera of pose", problem.camera_of_pose.len(), poses),
    ];
    match lengths.into_iter().find(|(_, found, wanted)| found != wanted) {
        Some((what, found, wanted)) => Err(BundleError::Length { what, found, wanted }),
        None => Ok(()),
    }
}

/// Refuses observations that are out of order, out of range or not finite.
fn check_observations(problem: &Problem) -> Result<(), BundleError> {
    let mut last = None;
    for (index, observation) in problem.observations.iter().enumerate() {
        known("observation", index, observation.point, problem.points.len())?;
        known("observation", index, observation.pose, problem.poses.len())?;
        if last >= Some((observation.point, observation.pose)) {
            return Err(BundleError::Order { index });
        }
        last = Some((observation.point, observation.pose));
    }
    let finite = |pixel: nalgebra::Vector2<f64>| pixel.x.is_finite() && pixel.y.is_finite();
    all_valid(
        "observation",
        problem
            .observations
            .iter()
            .map(|observation| finite(observation.pixel)),
    )
}

/// Refuses an index that is out of range.
fn known(what: &'static str, index: usize, target: u32, count: usize) -> Result<(), BundleError> {
    if (target as usize) < count {
        return Ok(());
    }
    Err(BundleError::Unknown {
        what,
        index,
        target,
        count,
    })
}

/// Refuses the first invalid item of a list.
fn all_valid(what: &'static str, mut valid: impl Iterator<Item = bool>) -> Result<(), BundleError> {
    match valid.position(|valid| !valid) {
        Some(index) => Err(BundleError::Invalid { what, index }),
        None => Ok(()),
    }
}

/// Whether a prior's numbers are finite, its sigmas and focal length positive and its photos two.
fn is_valid(prior: &Prior) -> bool {
    let positive = |value: f64| value > 0.0 && value.is_finite();
    match *prior {
        Prior::Centre { centre, sigma, .. } => {
            positive(sigma) && centre.iter().all(|value| value.is_finite())
        }
        Prior::Attitude {
            cam_from_world,
            sigma_rad,
            ..
        } => positive(sigma_rad) && cam_from_world.is_valid(),
        Prior::Relative {
            pose_1,
            pose_2,
            cam2_from_cam1,
            sigma_rad,
            sigma,
        } => pose_1 != pose_2 && positive(sigma_rad) && positive(sigma) && cam2_from_cam1.is_valid(),
        Prior::Focal {
            focal_px,
            sigma_share,
            ..
        } => positive(focal_px) && positive(sigma_share),
    }
}
