//! Poses, epipolar geometry and points from a few correspondences; no state, no policy.
//!
//! "Plane" is the undistorted image plane at z = 1: x / z, y / z. Everything is f64; what is not finite is
//! refused or dropped, never returned.

mod epipolar;
mod essential;
mod fundamental;
mod homography;
mod minimise;
mod p3p;
mod ransac;
mod resect;
mod roots;
mod rotation;
mod similarity;
mod svd;
mod triangulate;

#[cfg(test)]
pub(crate) mod scenes;

pub(crate) use epipolar::{Family, Pair, depths, essential_of, polish_epipolar, pose_of_essential, sampson2};
pub(crate) use essential::five_point;
pub(crate) use fundamental::{eight_point, seven_point};
pub(crate) use homography::{TwoWay, plane_motions, transfer2, two_way_homography};
pub(crate) use ransac::{Consensus, Trials, better, improved, lo_ransac};
pub(crate) use rotation::{cross_matrix, turn_between};

pub(crate) use {
    resect::{Resection, Seen, resect},
    rotation::{log_so3, nearest_rotation, ray_angle_rad},
    similarity::Similarity,
    triangulate::{Sight, triangulate_robust},
};
