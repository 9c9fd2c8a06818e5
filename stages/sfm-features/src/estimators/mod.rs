//! Minimal and least-squares solvers for poses, epipolar geometry and points, as pure functions.
//!
//! "Plane" is the undistorted image plane at z = 1: x / z, y / z. Everything is f64. Values that are not finite are
//! refused or dropped, never returned.

mod epipolar;
mod essential;
mod fundamental;
mod homography;
mod levenberg_marquardt;
mod p3p;
mod ransac;
mod resection;
mod roots;
mod rotation;
mod svd;
mod triangulation;

#[cfg(test)]
pub(crate) mod scenes;

pub use epipolar::{PointPair, essential_of, sampson2};
pub use ransac::{Consensus, RansacOptions};
pub use resection::{PointObservation, Resection, resect};
pub use rotation::{log_so3, nearest_rotation, ray_angle_rad};
pub use triangulation::{Ray, TriangulatedPoint, triangulate_robust};

pub(crate) use epipolar::{EpipolarModel, depths, pose_of_essential};
pub(crate) use essential::five_point;
pub(crate) use fundamental::{eight_point, seven_point};
pub(crate) use homography::{InvertibleHomography, poses_from_homography, ransac_homography, transfer2};
pub(crate) use ransac::{locally_optimised, scored_if_better};
pub(crate) use rotation::{cross_matrix, rotation_between};
