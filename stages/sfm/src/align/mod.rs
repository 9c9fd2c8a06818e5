//! Alignment of one coordinate frame with another by the poses of photos known in both.

mod align_poses;
mod similarity;

pub use align_poses::{Alignment, Tolerance, align, pose_difference};
pub use similarity::Similarity;
