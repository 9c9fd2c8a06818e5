//! Poses, epipolar geometry and points from a few correspondences; no state, no policy.
