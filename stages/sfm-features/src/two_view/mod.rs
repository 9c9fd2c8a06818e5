//! Two-view geometry: verification of matches, focal length from pairs, relative pose.
//!
//! All counts are of distinct correspondences: two features at one position count once.

mod correspondences;
mod fit_models;
mod focal;
mod pure_rotation;
mod ray_matches;
mod relative_pose;
mod types;
mod verify;

pub use focal::focal_from_pairs;
pub use relative_pose::estimate_relative_pose;
pub use types::{
    FocalKnown, RelativePose, RelativePoseKind, VerifiedKind, VerifiedPair, VerifyOptions, ViewPoints,
};
pub use verify::verify;

#[cfg(test)]
mod tests;
