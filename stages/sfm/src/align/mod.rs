//! Alignment of one coordinate frame with another by the poses of photos, or by points, that are known in both.

mod align_points;
mod align_poses;
mod similarity;

pub use align_points::{PointAlignment, Sighting, align_points};
pub use align_poses::{Alignment, PosePair, Tolerance, align, pose_difference};
pub use similarity::Similarity;
