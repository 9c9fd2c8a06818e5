//! Bundle adjustment: poses, points and camera parameters that minimise the reprojection error, in f64.
//!
//! `index` lists which pose observes which point, `state` holds the parameters, `residual` one observation and its
//! derivatives. `normal_equations` sums them, `schur` eliminates the points, `dense` or `conjugate_gradients` solve
//! the reduced system, `adjust` iterates (Levenberg-Marquardt).

mod adjust;
mod cholesky;
mod cholesky3;
mod conjugate_gradients;
mod covariance;
mod dense;
mod index;
mod loss;
mod normal_equations;
mod objective;
mod options;
mod priors;
mod problem;
mod residual;
mod schur;
mod so3;
mod state;
mod step_control;
mod validate;

pub use adjust::adjust;
pub use covariance::{own_pose_covariances, pose_covariances};
pub use loss::Loss;
pub use options::{BundleOptions, BundleReport, Solver, information_criterion};
pub use problem::{CameraFreedom, LensModel, Observation, PoseFreedom, Prior, Problem};
pub use validate::BundleError;

#[cfg(test)]
#[path = "../../tests/common/bundle_scene.rs"]
mod synthetic;
#[cfg(test)]
mod tests;
