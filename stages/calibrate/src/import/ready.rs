//! Photos as the cameras of an import show them: in their stored grid, and without a distortion that [`Camera`] does not have.

use marf_cache::{Digest, digest_of};
use marf_scene::{Camera, Image, PhotoFacts, Srgb, encode_png};
use marf_schema::calibrate::CalibrateParams;
use marf_stage::{Ctx, Inputs, StageError};

use super::cameras::{ImportError, Role, View, refused};
use super::distortion::Distortion;
use super::undistort::Undistorter;
use crate::calibration::{HeldOut, PhotoStatistics, PlacedPhoto};
use crate::mask_files::{HIDDEN, blackened, only_white, stored_mask};
use crate::orientation::Orientation;
use crate::photos::{InputPhoto, as_png, decode, kept, reduced, reduction, size_px, store, with_other_grid};

/// A photo in the grid of its camera, before it is reduced.
pub(crate) struct ReadyPhoto {
    pub item: InputPhoto,
    camera: Camera,
}

/// Returns a photo with the camera of its view, which is for pixels of this size. `source` is named in errors.
fn as_it_is(
    source: &str,
    view: &View,
    item: &InputPhoto,
    [width, height]: [u32; 2],
) -> Result<ReadyPhoto, StageError> {
    let camera = view
        .lens
        .camera(width, height)
        .map_err(|problem| unfit(source, view, item, &problem))?;
    let item = item.clone();
    Ok(ReadyPhoto { item, camera })
}

/// Returns a photo in its stored grid, without a distortion that the camera lacks, with its mask.
///
/// A photo that needs neither keeps its bytes. Every other one becomes a PNG.
pub(super) fn ready(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    source: &str,
    view: &View,
    item: &InputPhoto,
) -> Result<ReadyPhoto, StageError> {
    let stored_px = item.orientation().other_size(size_px(ctx, item)?);
    let unchanged = as_it_is(source, view, item, stored_px)?;
    let undistorter = match view.lens.distortion {
        Distortion::Brown(_) => None,
        distortion => {
            let undistorter = Undistorter::new(unchanged.camera, distortion);
            Some(undistorter.map_err(|problem| unfit(source, view, item, &problem))?)
        }
    };
    if undistorter.is_none() && item.orientation() == Orientation::UPRIGHT {
        return Ok(unchanged);
    }
    let camera = undistorter.as_ref().map_or(unchanged.camera, |one| one.pinhole);
    let change = Change {
        orientation: item.orientation(),
        undistorter,
    };
    Ok(ReadyPhoto {
        item: InputPhoto {
            mask: change.mask(ctx, inputs, item)?,
            ..InputPhoto::new(
                item.id.clone(),
                change.known_photo(ctx, item, view)?,
                PhotoFacts {
                    file: as_png(&item.facts.file),
                    width: camera.width,
                    height: camera.height,
                    notes: Vec::new(),
                    ..item.facts.clone()
                },
            )
        },
        camera,
    })
}

/// Returns the error of a photo that its camera does not fit.
fn unfit(source: &str, view: &View, item: &InputPhoto, problem: &str) -> StageError {
    let problem = format!("photo `{}`: {problem}", item.id);
    refused(ImportError::new(source, &view.place, problem))
}

/// Changes to the pixels of a photo.
struct Change {
    orientation: Orientation,
    undistorter: Option<Undistorter>,
}

impl Change {
    /// Returns the digest of the changed photo as PNG. The result of an earlier run is taken from the memo.
    fn known_photo(&self, ctx: &Ctx<'_>, item: &InputPhoto, view: &View) -> Result<Digest, StageError> {
        let lens = format!("{:?} {:?}", self.orientation, view.lens);
        let key = digest_of(&("calibrate imported photo 1", item.image, lens));
        let known = ctx.memos.load(&key).and_then(|bytes| {
            let digest = Digest::from_bytes((*bytes).try_into().ok()?);
            kept(ctx, &digest).then_some(digest)
        });
        if let Some(known) = known {
            return Ok(known);
        }
        let changed = with_other_grid(decode(ctx, item)?, |pixels| {
            self.changed(ctx, &self.orientation.stored(pixels), item)
        });
        let digest = store(ctx, item, &changed?)?;
        ctx.memos.save(&key, digest.as_bytes());
        Ok(digest)
    }

    /// Returns the digest of the changed mask of a photo as PNG, if it has one.
    fn mask(&self, ctx: &Ctx<'_>, inputs: &Inputs, item: &InputPhoto) -> Result<Option<Digest>, StageError> {
        let Some(mut mask) = stored_mask(ctx, inputs, item)? else {
            return Ok(None);
        };
        only_white(&mut mask, |pixel| pixel != HIDDEN);
        let mut changed = self.changed(ctx, &mask, item)?;
        blackened(&mut changed);
        let png = encode_png(&changed).map_err(|error| StageError::new(error.to_string()))?;
        Ok(Some(ctx.put(&png)?))
    }

    /// Returns stored pixels without distortion.
    fn changed(
        &self,
        ctx: &Ctx<'_>,
        stored: &Image<Srgb>,
        item: &InputPhoto,
    ) -> Result<Image<Srgb>, StageError> {
        let Some(undistorter) = &self.undistorter else {
            return Ok(stored.clone());
        };
        undistorter
            .resample(stored, ctx.cancel)
            .map_err(|pixel| match pixel {
                Some(at) => StageError::new(format!(
                    "photo `{}`: its lens does not show ({}, {})",
                    item.id, at.x, at.y
                )),
                None => StageError::Cancelled,
            })
    }
}

/// Returns a photo of the input set where its view has it, at the size that the field is trained on.
pub(super) fn placed(
    ctx: &Ctx<'_>,
    item: usize,
    view: &View,
    ready: &ReadyPhoto,
    params: &CalibrateParams,
) -> Result<PlacedPhoto, StageError> {
    let ReadyPhoto { item: photo, camera } = ready;
    let factor = reduction(camera.width, camera.height, params.longest_side_px);
    let (image, file) = if factor == 1 {
        (photo.image, photo.facts.file.clone())
    } else {
        let full_px = [camera.width, camera.height];
        let image = reduced(ctx, &photo.id, &photo.image, full_px, factor)?;
        (image, as_png(&photo.facts.file))
    };
    Ok(PlacedPhoto {
        item,
        file,
        image,
        mask: photo.mask,
        camera: camera.box_reduced(factor),
        cam_from_world: view.cam_from_world,
        held_out: match view.role {
            Role::Open => None,
            Role::HeldOut => Some(HeldOut::Yes),
            Role::Train | Role::Unlisted => Some(HeldOut::No),
        },
        statistics: PhotoStatistics {
            matches: view.matches,
            inliers: view.inliers,
            error_px: view.error_px,
            ..PhotoStatistics::default()
        },
    })
}
