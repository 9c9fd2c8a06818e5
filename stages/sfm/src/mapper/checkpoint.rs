//! When a mapping is saved, and what its checkpoint is of.

use super::input::{MapError, MapperInput};
use super::options::{LensChoice, PrincipalPointChoice};
use crate::bytes::{Fingerprint, Writer};
use crate::supervisor::SAVE_UNFINISHED;
use crate::two_view::FocalKnown;

/// Name under which the state of a mapping is saved.
pub(super) const PART: &str = "mapping";

/// Tells whether the state after a step is to be saved.
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
    let mut found = Fingerprint::new();
    let mut writer = Writer::new(b"mapinput", 0);
    writer.list(input.cameras, |writer, shared| {
        writer.camera(&shared.camera);
        writer.count(u64::from(shared.focal == FocalKnown::Known));
        writer.option(shared.focal_sigma_share.as_ref(), |writer, sigma| {
            writer.number(*sigma);
        });
    });
    writer.list(input.views, |writer, view| writer.count(view.camera as u64));
    writer.list(input.links, |writer, link| {
        let pose = &link.relative_pose;
        link.photos.iter().for_each(|photo| writer.count(*photo as u64));
        writer.count(pose.inliers.len() as u64);
        writer.pose(&pose.cam2_from_cam1);
        writer.number(pose.median_angle_rad);
        writer.number(pose.forward);
    });
    let options = &input.options;
    writer.number(options.max_error_px);
    writer.number(options.min_angle_rad);
    writer.count(match options.lens {
        LensChoice::Smallest { growing } => growing as u64,
        LensChoice::Fixed(lens) => 16 + lens as u64,
    });
    writer.count(match options.principal_point {
        PrincipalPointChoice::Fixed => 0,
        PrincipalPointChoice::Free => 1,
        PrincipalPointChoice::Supported => 2,
    });
    writer.count(options.seed);
    found.add_state(writer);
    for observation in &input.tracks.observations {
        found.add(u64::from(observation.track) << 32 | u64::from(observation.photo));
        found.add(observation.pixel.x.to_bits());
        found.add(observation.pixel.y.to_bits());
    }
    found.value()
}
