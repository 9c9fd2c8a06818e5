//! Masks of what is fixed to a camera: found by points that its photos never show, outlined by what stands still in its pictures.

use std::collections::BTreeSet;

use marf_cache::Digest;
use marf_scene::{Image, Photo, Srgb, encode_png};
use marf_sfm::mapper::FixedPart;
use marf_stage::{Ctx, Inputs, StageError};
use rayon::prelude::*;

use super::photo_features::FeatureRow;
use super::reconstruction::Reconstruction;
use crate::calibration::Calibration;
use crate::labels::Candidate;
use crate::mask_files::{HIDDEN, OPEN, undistorted_mask};
use crate::masks::gray;
use crate::masks::stationary::{Gray, StationaryParts, grown_by};
use crate::photos::reduction;

/// Longest side of the pictures that are compared, pixels, and how many are at most.
const COMPARED_PX: u32 = 160;
const MOST_PHOTOS: usize = 24;
/// Pixels of the compared pictures by which an outline is widened: windows over its rim hold ground, too.
const MARGIN: usize = 1;

/// Hides what is fixed to cameras.
pub(super) struct FixedMasks<'a> {
    pub ctx: &'a Ctx<'a>,
    pub inputs: &'a Inputs,
    pub reconstruction: &'a Reconstruction<'a>,
    /// Of each photo.
    pub candidates: &'a [Option<Candidate<'a>>],
}

impl FixedMasks<'_> {
    /// Gives the placed photos of each camera with a fixed part a mask of it, in addition to their own.
    pub(super) fn hide(&self, calibration: &mut Calibration) -> Result<(), StageError> {
        let parts = self
            .reconstruction
            .intruders
            .iter()
            .flat_map(|found| &found.fixed);
        let mut done = BTreeSet::new();
        for part in parts.filter(|part| done.insert(part.camera)) {
            let view = |item: usize| &self.reconstruction.input.views[item];
            let placed = calibration.placed.iter_mut();
            let mut placed: Vec<_> = placed
                .filter(|one| view(one.item).camera == part.camera)
                .collect();
            let items: Vec<usize> = placed.iter().map(|one| one.item).collect();
            let outline = self.outline(&items)?;
            let masks: Vec<Digest> = items
                .par_iter()
                .map(|item| self.mask(*item, part, &outline))
                .collect::<Result<_, _>>()?;
            for (one, mask) in placed.iter_mut().zip(masks) {
                one.mask = Some(mask);
            }
            calibration.method += &format!(
                ". A part that moves with the camera is hidden in {} photos: of {} points expected there, they show {}",
                items.len(),
                part.expected,
                part.shown
            );
        }
        Ok(())
    }

    fn row(&self, item: usize) -> &FeatureRow {
        &self.reconstruction.features[item].row
    }

    /// Returns what stands still in some of the photos.
    fn outline(&self, items: &[usize]) -> Result<Outline, StageError> {
        let stride = items.len().div_ceil(MOST_PHOTOS).max(1);
        let some: Vec<usize> = items.iter().copied().step_by(stride).collect();
        let read = |item: &usize| -> Result<Gray, StageError> {
            self.ctx.check()?;
            let row = self.row(*item);
            let photo = Photo::decode_validated(&self.ctx.get(&row.image)?);
            let photo = photo.map_err(|error| {
                StageError::new(format!(
                    "photo `{}`: {error}",
                    self.reconstruction.items[*item].id
                ))
            })?;
            let factor = reduction(row.width, row.height, Some(COMPARED_PX));
            Ok(gray(&photo.image.box_reduced(factor)))
        };
        let mut photos: Vec<Gray> = some.par_iter().map(read).collect::<Result<_, _>>()?;
        let size = |gray: &Gray| (gray.width, gray.values.len());
        let first = photos.first().map(size);
        photos.retain(|photo| Some(size(photo)) == first);
        let (width, pixels) = first.unwrap_or_default();
        let found = StationaryParts::find(&photos, &vec![false; pixels]);
        Ok(Outline {
            width,
            is_in: grown_by(&found.is_stationary, width, MARGIN),
        })
    }

    /// Stores the mask of a photo: its own, the part and the outline.
    fn mask(&self, item: usize, part: &FixedPart, outline: &Outline) -> Result<Digest, StageError> {
        let (photo, row) = (&self.reconstruction.items[item], self.row(item));
        let own = undistorted_mask(self.ctx, self.inputs, photo, self.candidates[item].as_ref())?;
        let mask = Image::<Srgb>::from_fn(row.width, row.height, |column, line| {
            let share = |at: u32, side: u32| (f64::from(at) + 0.5) / f64::from(side);
            let (x, y) = (share(column, row.width), share(line, row.height));
            let is_own = own.as_ref().is_some_and(|own| own.at(column, line) == HIDDEN);
            if is_own || part.covers(x, y) || outline.covers(x, y) {
                HIDDEN
            } else {
                OPEN
            }
        });
        let png = encode_png(&mask).map_err(|error| StageError::new(error.to_string()))?;
        self.ctx.put(&png)
    }
}

/// Pixels of a small picture that stand still.
struct Outline {
    width: usize,
    is_in: Vec<bool>,
}

impl Outline {
    /// Returns whether it covers a place of a picture, as shares of width and height in [0, 1).
    fn covers(&self, x: f64, y: f64) -> bool {
        let height = self.is_in.len().checked_div(self.width).unwrap_or(0);
        let (column, row) = ((x * self.width as f64) as usize, (y * height as f64) as usize);
        column < self.width && row < height && self.is_in[row * self.width + column]
    }
}
