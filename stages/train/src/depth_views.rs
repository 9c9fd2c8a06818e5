//! Distances that a field shows in photos, at a small size: what a photo shows and what is hidden from it.

use marf_field::{Field, Render};
use marf_scene::{DepthView, Frame, Scene, TrainedPhotos};
use marf_stage::StageError;

use crate::{error::field_failed, photos::PhotoReader};

/// Mean opacity up to which a pixel has no depth: the ray goes on into the sky.
pub(crate) const MIN_OPACITY: f32 = 0.5;
/// Longest side of a view, pixels. A thousand photos then take as many rays as one photo of 1024 x 768.
const SIDE_PX: u32 = 32;

/// Returns the distance to the surface at each pixel of a render, infinite in the sky.
pub(crate) fn surface_distances(render: &Render) -> impl Iterator<Item = f32> {
    let matter = render.depth.iter().zip(&render.opacity);
    matter.map(|(depth, opacity)| {
        if *opacity > MIN_OPACITY {
            *depth
        } else {
            f32::INFINITY
        }
    })
}

/// Returns the photos that a field is trained on, with what it shows in each.
///
/// # Errors
/// Those of [`depth_view`].
pub(crate) fn trained_photos<'a>(
    field: &Field,
    photos: &PhotoReader<'_>,
    scene: &Scene,
    frames: &[&'a Frame],
) -> Result<TrainedPhotos<'a>, StageError> {
    let views: Result<Vec<DepthView>, _> = frames
        .iter()
        .map(|frame| depth_view(field, photos, frame))
        .collect();
    let posed = frames.iter().map(|frame| (*frame).into()).collect();
    Ok(TrainedPhotos::new(scene, posed, &views?))
}

/// Renders the distances of a field in a photo.
///
/// # Errors
/// A mask that cannot be read, a field that cannot be rendered, a run that is stopped.
pub(crate) fn depth_view(
    field: &Field,
    photos: &PhotoReader<'_>,
    frame: &Frame,
) -> Result<DepthView, StageError> {
    photos.ctx.check()?;
    let (width, height) = (frame.camera.width, frame.camera.height);
    let every = width
        .max(height)
        .div_ceil(SIDE_PX)
        .clamp(1, width.min(height).max(1));
    let camera = frame.camera.box_reduced(every);
    let render = field
        .render(&camera, &frame.cam_from_world)
        .map_err(field_failed)?;
    let mut distance: Vec<f32> = surface_distances(&render).collect();
    let hidden = photos.hidden_at(frame, every)?;
    for (distance, _) in distance.iter_mut().zip(hidden).filter(|(_, hidden)| *hidden) {
        *distance = f32::NAN;
    }
    Ok(DepthView {
        camera,
        cam_from_world: frame.cam_from_world,
        distance,
    })
}
