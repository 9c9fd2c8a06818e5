//! The viewpoints of a path.

use marf_scene::{
    Frame, Pose, Scene,
    path::{self, Viewpoint},
};
use marf_schema::render::{PathKind, Place, RenderParams};

use super::layers::film_size;
use crate::{TrainError, split::named_frames};

/// Returns the cameras along the path.
///
/// # Errors
/// The scene has no such path, or no video can hold the film. The check comes before the first picture is rendered.
pub(super) fn viewpoints(scene: &Scene, params: &RenderParams) -> Result<Vec<Viewpoint>, TrainError> {
    let mut path = match params.path {
        PathKind::Flythrough => path::flythrough(scene, params.frames, params.width),
        PathKind::Heldout => photos(scene, params, |frame| frame.held_out),
        PathKind::Train => photos(scene, params, |frame| !frame.held_out),
        PathKind::Orbit => {
            path::up_direction(scene).ok_or(TrainError::NoUp)?;
            path::orbit(scene, params.frames, params.width)
        }
        PathKind::Keyframes => keyframes(params),
        PathKind::Stills => stills(params),
    };
    if let Some(height) = params.height {
        for place in &mut path {
            place.camera = place.camera.with_height(height);
        }
    }
    let Some(first) = path.first() else {
        let path = params.path.name();
        return Err(TrainError::NoPath { path });
    };
    if params.path != PathKind::Stills {
        let (width, height) = film_size(&first.camera, &params.outputs);
        marf_video::check_size(width, height)?;
    }
    Ok(path)
}

/// Returns the cameras of the first photos of a kind.
fn photos(scene: &Scene, params: &RenderParams, is_of_kind: impl Fn(&Frame) -> bool) -> Vec<Viewpoint> {
    let frames = named_frames(scene).into_iter();
    let chosen = frames.filter(|named| is_of_kind(named.frame));
    let first = chosen.take(params.frames as usize);
    path::viewpoints_at(first.map(|named| (named.frame, named.name)), params.width)
}

/// Returns the cameras along a smooth path through the keyframes, with the lens of the first.
fn keyframes(params: &RenderParams) -> Vec<Viewpoint> {
    let poses: Vec<Pose> = params
        .keyframes
        .iter()
        .map(|place| place.cam_from_world)
        .collect();
    let Some(first) = params.keyframes.first() else {
        return Vec::new();
    };
    path::through(&poses, path::to_width(&first.camera, params.width), params.frames)
}

fn stills(params: &RenderParams) -> Vec<Viewpoint> {
    let still = |place: &Place| Viewpoint {
        name: place.name.clone(),
        camera: path::to_width(&place.camera, params.width),
        cam_from_world: place.cam_from_world,
    };
    params.keyframes.iter().map(still).collect()
}

/// Returns the cameras as they are written.
pub(super) fn places(path: &[Viewpoint]) -> Vec<Place> {
    path.iter()
        .map(|viewpoint| Place {
            name: viewpoint.name.clone(),
            camera: viewpoint.camera,
            cam_from_world: viewpoint.cam_from_world,
        })
        .collect()
}
