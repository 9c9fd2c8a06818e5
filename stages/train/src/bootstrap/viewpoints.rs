//! The viewpoints that maps are made at.

use marf_cache::Digest;
use marf_scene::{
    Camera, Image, Photo, PosedPhoto, Scene, Srgb,
    path::{self, Viewpoint},
    picture_names, places_of,
};
use marf_schema::{
    bootstrap::{BootstrapParams, ViewpointList, Viewpoints},
    output::PHOTO,
};
use marf_stage::{Ctx, StageError};

use super::study::Truth;
use crate::{TrainError, child::Child, photos::PhotoReader, split::NamedFrame};

/// A viewpoint of maps.
pub(super) struct MapView {
    pub place: Viewpoint,
    /// Of a photo that was held out.
    pub photo: Option<HeldOutPhoto>,
}

/// A photo that was held out, as the first member wrote it.
pub(super) struct HeldOutPhoto {
    pub digest: Digest,
    /// Pixels that its mask hides. Empty without a mask.
    hidden: Vec<bool>,
    /// Number of the place it was taken at.
    place: usize,
}

impl MapView {
    /// Reads the photo, if one was held out.
    pub fn image(&self, ctx: &Ctx<'_>) -> Result<Option<Image<Srgb>>, StageError> {
        let Some(photo) = &self.photo else {
            return Ok(None);
        };
        let decoded = Photo::decode(&ctx.get(&photo.digest)?).map_err(|error| TrainError::Picture {
            name: self.place.name.clone(),
            cause: error.to_string(),
        });
        Ok(Some(decoded?.image))
    }

    /// Returns the photo with its mask, to compare the maps with.
    pub fn truth<'a>(&'a self, image: Option<&'a Image<Srgb>>) -> Option<Truth<'a>> {
        let photo = self.photo.as_ref()?;
        Some(Truth {
            photo: image?,
            hidden: &photo.hidden,
            place: photo.place,
        })
    }
}

/// Returns the viewpoints to map, kind by kind. `photos` reads at the scale of the members.
///
/// # Errors
/// A kind that has no viewpoint in this scene.
pub(super) fn map_views(
    photos: &PhotoReader<'_>,
    params: &BootstrapParams,
    scene: &Scene,
    training: &[NamedFrame<'_>],
    first: &Child<'_>,
) -> Result<Vec<MapView>, StageError> {
    let scale = photos.scale;
    let widths = scene.frames.iter().map(|frame| frame.camera.width);
    let width = (widths.max().unwrap_or(1) / scale).max(1);
    let frames = params.map_frames;
    let ViewpointList(kinds) = &params.viewpoints;
    let mut views = Vec::new();
    for kind in kinds {
        let (name, of_kind) = match kind {
            Viewpoints::Heldout => ("heldout", held_out_views(photos, scene, first)?),
            Viewpoints::Train => ("train", training_views(training, scale)),
            Viewpoints::Flythrough => (
                "flythrough",
                along("flythrough", path::flythrough(scene, frames, width)),
            ),
            Viewpoints::Orbit => ("orbit", along("orbit", path::orbit(scene, frames, width))),
        };
        if of_kind.is_empty() {
            return Err(TrainError::NoViewpoint { viewpoints: name }.into());
        }
        views.extend(of_kind);
    }
    Ok(views)
}

/// Returns viewpoints of a path under its name: those of two paths have the same numbers.
fn along(path: &str, places: Vec<Viewpoint>) -> Vec<MapView> {
    let named = places.into_iter().map(|place| MapView {
        place: Viewpoint {
            name: format!("{path}-{}", place.name),
            ..place
        },
        photo: None,
    });
    named.collect()
}

fn training_views(training: &[NamedFrame<'_>], scale: u32) -> Vec<MapView> {
    let views = training.iter().map(|named| MapView {
        place: Viewpoint {
            name: named.name.clone(),
            camera: named.frame.camera.box_reduced(scale),
            cam_from_world: named.frame.cam_from_world,
        },
        photo: None,
    });
    views.collect()
}

/// Returns the views of the photos that the members held out, with the photos as the first member wrote them.
fn held_out_views(
    photos: &PhotoReader<'_>,
    scene: &Scene,
    first: &Child<'_>,
) -> Result<Vec<MapView>, StageError> {
    let posed: Vec<PosedPhoto<'_>> = scene.frames.iter().map(PosedPhoto::from).collect();
    let places = places_of(&posed, &scene.points);
    let mut views = Vec::new();
    for ((frame, name), place) in scene.frames.iter().zip(picture_names(scene)).zip(places) {
        let output = format!("{PHOTO}{name}.png");
        let Some(digest) = first.outputs.get(&output) else {
            continue;
        };
        let photo = HeldOutPhoto {
            digest: *digest,
            hidden: photos.hidden(frame)?,
            place,
        };
        let size =
            Photo::decode(&photos.ctx.get(digest)?).map_err(|error| first.malformed(&output, &error))?;
        views.push(MapView {
            place: Viewpoint {
                name,
                camera: sized(&frame.camera.box_reduced(photos.scale), &size.image),
                cam_from_world: frame.cam_from_world,
            },
            photo: Some(photo),
        });
    }
    Ok(views)
}

/// Returns the camera with the size of the photo as it was written.
fn sized(camera: &Camera, photo: &Image<Srgb>) -> Camera {
    Camera {
        width: photo.width,
        height: photo.height,
        ..*camera
    }
}
