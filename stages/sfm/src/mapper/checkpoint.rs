//! When a mapping is saved, and what its checkpoint is of.

use marf_sfm_features::two_view::FocalKnown;

use super::input::{MapError, MapperInput};
use crate::bytes;
use crate::supervisor::SAVE_UNFINISHED;

/// Name under which the state of a mapping is saved.
pub(super) const PART: &str = "mapping";

/// Whether to save the state after a step.
///
/// # Errors
/// [`MapError::Stopped`]: the step may then have been cut short, and its state is worth nothing.
pub(super) fn is_due(input: &MapperInput<'_>) -> Result<bool, MapError> {
    if input.supervisor.stop() {
        return Err(MapError::Stopped);
    }
    Ok(input.supervisor.unsaved_for() >= SAVE_UNFINISHED)
}

/// Returns a fingerprint of all that a mapping depends on.
pub(super) fn fingerprint(input: &MapperInput<'_>) -> u64 {
    let cameras = input.cameras.iter().map(|shared| {
        let is_known = shared.focal == FocalKnown::Known;
        (shared.camera, is_known, shared.focal_sigma_share)
    });
    let cameras: Vec<_> = cameras.collect();
    let camera_of_view: Vec<usize> = input.views.iter().map(|view| view.camera).collect();
    let links = input.links.iter().map(|link| {
        let pose = &link.relative_pose;
        let numbers = [pose.median_angle_rad, pose.forward];
        (link.photos, pose.inliers.len(), pose.cam2_from_cam1, numbers)
    });
    let links: Vec<_> = links.collect();
    let observations = &input.tracks.observations;
    bytes::fingerprint(&(cameras, camera_of_view, links, &input.options, observations))
}
