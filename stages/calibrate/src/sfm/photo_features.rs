//! Features of every photo, computed or from the memo.

use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::{Digest, digest_of};
use marf_scene::{Camera, Image, Pose, Srgb};
use marf_schema::calibrate::{CalibrateParams, FirstOctaveParam};
use marf_sfm_features::features::{FeatureOptions, Features, FirstOctave, Gray, Mask, extract};
use marf_stage::{Ctx, Inputs, StageError};
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::labels::{Candidate, Pixels, ideal, photo_key};
use crate::mask_files::undistorted_mask;
use crate::photos::{InputPhoto, as_png, decode, kept, store};

/// Raised when features, working images or label cameras may change.
const VERSION: u32 = 2;

/// The features of a photo, with the row that is kept of it.
pub(crate) struct PhotoFeatures {
    pub row: FeatureRow,
    pub features: Features,
    /// sRGB at each feature.
    pub colors: Vec<[u8; 3]>,
}

impl PhotoFeatures {
    /// Returns the positions of the features, pixels of the working size.
    pub(crate) fn pixels(&self) -> Vec<Vector2<f64>> {
        let points = self.features.keypoints.iter();
        points
            .map(|point| Vector2::new(f64::from(point.x_px), f64::from(point.y_px)))
            .collect()
    }
}

/// Data of a photo that are kept from run to run in addition to its features.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct FeatureRow {
    /// The image the frame will name: the photo's own, or the one resampled through its label's model.
    pub image: Digest,
    /// The file name of the resampled image.
    pub file: Option<String>,
    pub width: u32,
    pub height: u32,
    /// Factor by which the working size is smaller.
    pub factor: u32,
    /// Camera of that image and pose in its site, from the label.
    pub label: Option<(Camera, Pose)>,
    /// Why the label could not be used.
    pub note: Option<String>,
    /// Digest of its features: part of the keys of its pairs.
    pub found: Digest,
}

impl FeatureRow {
    /// Returns a camera of this photo, which may be of a reduced size, at the working size.
    ///
    /// A photo reduced by boxes has lost the columns and rows that fill none: its scale is exactly one over the factor, not the ratio of
    /// the sizes.
    pub(super) fn at_working_size(&self, camera: &Camera) -> Camera {
        let size_px = [self.width, self.height];
        let is_size = |factor: &u32| size_px.map(|side| side / factor) == [camera.width, camera.height];
        match (1..=self.width.max(1)).find(is_size) {
            Some(factor) => camera.unreduced(factor, size_px).box_reduced(self.factor),
            None => camera.resized(self.width / self.factor, self.height / self.factor),
        }
    }
}

/// Returns the features of each photo, resampled if the lens of its label is not a pinhole. Results of an earlier run are taken from the
/// memo.
pub(super) fn photo_features(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[InputPhoto],
    candidates: &[Option<Candidate<'_>>],
    params: &CalibrateParams,
) -> Result<Vec<PhotoFeatures>, StageError> {
    let done = AtomicU64::new(0);
    let found = (0..items.len()).into_par_iter().map(|item| {
        ctx.check()?;
        let mask = undistorted_mask(ctx, inputs, &items[item], candidates[item].as_ref())?;
        let found = features_of(
            ctx,
            &items[item],
            candidates[item].as_ref(),
            mask.as_ref(),
            params,
        )?;
        let so_far = done.fetch_add(1, Ordering::Relaxed) + 1;
        ctx.progress
            .at(so_far, items.len() as u64, "photos searched for features");
        Ok(found)
    });
    found.collect()
}

/// Returns the features of a photo. Those of an earlier run are taken from the memo.
pub(crate) fn features_of(
    ctx: &Ctx<'_>,
    item: &InputPhoto,
    candidate: Option<&Candidate<'_>>,
    mask: Option<&Image<Srgb>>,
    params: &CalibrateParams,
) -> Result<PhotoFeatures, StageError> {
    let doubled = params.first_octave == FirstOctaveParam::Doubled;
    let options = (params.max_features, params.feature_side_px, doubled);
    let key = digest_of(&(
        ("calibrate features", VERSION),
        options,
        row_key(item, candidate, mask),
    ));
    if let Some(known) = ctx.memos.load(&key).and_then(|row| recall(ctx, &row)) {
        return Ok(known);
    }
    let found = computed(ctx, item, candidate, mask, params)?;
    let row = serde_json::to_vec(&found.row).map_err(|error| StageError::new(error.to_string()))?;
    ctx.memos.save(&key, &row);
    Ok(found)
}

/// Returns the digest of all of a photo that its features depend on.
fn row_key(item: &InputPhoto, candidate: Option<&Candidate<'_>>, mask: Option<&Image<Srgb>>) -> Digest {
    let mask = mask.map(|mask| Digest::from_content(mask.pixels.as_flattened()));
    photo_key(item, candidate, mask)
}

/// Returns the features of a row, if they are still stored.
fn recall(ctx: &Ctx<'_>, row: &[u8]) -> Option<PhotoFeatures> {
    let row: FeatureRow = serde_json::from_slice(row).ok()?;
    if row.file.is_some() {
        // The resampled image must still be there: the frame will name it.
        kept(ctx, &row.image).then_some(())?;
    }
    let found = ctx.get(&row.found).ok()?;
    let (features, colors) = unpack(&found)?;
    // What this run uses is part of its record, so that the memo lives as long as the last run that needs it.
    ctx.put(&found).ok()?;
    Some(PhotoFeatures {
        row,
        features,
        colors,
    })
}

/// Extracts the features of the photo itself, or of its image resampled to the pinhole of its label.
fn computed(
    ctx: &Ctx<'_>,
    item: &InputPhoto,
    candidate: Option<&Candidate<'_>>,
    mask: Option<&Image<Srgb>>,
    params: &CalibrateParams,
) -> Result<PhotoFeatures, StageError> {
    let (mut note, mut label) = (None, None);
    let (mut image, mut file) = (item.image, None);
    let ideal = candidate
        .map(|candidate| ideal(ctx, item, candidate))
        .transpose()?;
    let photo = match ideal {
        Some(Ok(ideal)) => {
            label = Some((ideal.camera, ideal.cam_from_site));
            if ideal.pixels == Pixels::Resampled {
                (image, file) = (store(ctx, item, &ideal.photo)?, Some(as_png(&item.facts.file)));
            }
            ideal.photo.image
        }
        Some(Err(reason)) => {
            note = Some(reason);
            decode(ctx, item)?.image
        }
        None => decode(ctx, item)?.image,
    };
    let factor = photo
        .width
        .max(photo.height)
        .div_ceil(params.feature_side_px)
        .max(1);
    let features = extract(
        &Gray::from_photo(&photo, factor),
        &Mask::from_photo(&photo, factor, mask),
        &options(params),
        &|| ctx.cancel.is_set(),
    );
    let features = features.ok_or(StageError::Cancelled)?;
    let points = features.keypoints.iter();
    let colors: Vec<[u8; 3]> = points
        .map(|point| color(&photo, factor, point.x_px, point.y_px))
        .collect();
    let row = FeatureRow {
        image,
        file,
        width: photo.width,
        height: photo.height,
        factor,
        label,
        note,
        found: ctx.put(&pack(&features, &colors))?,
    };
    Ok(PhotoFeatures {
        row,
        features,
        colors,
    })
}

/// Returns the options of feature extraction.
fn options(params: &CalibrateParams) -> FeatureOptions {
    FeatureOptions {
        max_features: params.max_features,
        first_octave: match params.first_octave {
            FirstOctaveParam::Native => FirstOctave::Native,
            FirstOctaveParam::Doubled => FirstOctave::Doubled,
        },
    }
}

/// Returns the colour at a position of the working size.
fn color(photo: &Image<Srgb>, factor: u32, x_px: f32, y_px: f32) -> [u8; 3] {
    let at = |position: f32, size: u32| ((position * factor as f32) as u32).min(size.saturating_sub(1));
    photo.at(at(x_px, photo.width), at(y_px, photo.height))
}

/// Returns features and colours as bytes: the colours follow, three bytes each.
fn pack(features: &Features, colors: &[[u8; 3]]) -> Vec<u8> {
    let features = features.encode();
    let mut bytes = (features.len() as u64).to_le_bytes().to_vec();
    bytes.extend(features);
    bytes.extend(colors.as_flattened());
    bytes
}

/// Reads what [`pack`] wrote.
fn unpack(bytes: &[u8]) -> Option<(Features, Vec<[u8; 3]>)> {
    let (len, rest) = bytes.split_first_chunk::<8>()?;
    let (features, colors) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*len)).ok()?)?;
    let features = Features::decode(features)?;
    let (colors, torn) = colors.as_chunks::<3>();
    (torn.is_empty() && colors.len() == features.keypoints.len()).then(|| (features, colors.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(width: u32, height: u32, factor: u32) -> FeatureRow {
        FeatureRow {
            image: Digest::from_content(b"image"),
            file: None,
            width,
            height,
            factor,
            label: None,
            note: None,
            found: Digest::from_content(b"features"),
        }
    }

    fn numbers(camera: &Camera) -> [f64; 4] {
        [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    }

    fn are_equal(found: &Camera, expected: &Camera) -> bool {
        let pairs = numbers(found).into_iter().zip(numbers(expected));
        let same = pairs.map(|(a, b)| (a / b - 1.0).abs()).all(|off| off < 1e-12);
        same && (found.width, found.height) == (expected.width, expected.height)
    }

    /// 5472 is no multiple of 5 nor of 7, and 3648 neither: boxes leave columns and rows out.
    #[test]
    fn a_camera_at_the_working_size_and_back_is_unchanged() {
        let row = row(5472, 3648, 5);
        let full = Camera {
            fy_px: 4010.0,
            cx_px: 2700.0,
            ..Camera::pinhole(5472, 3648, 4000.0)
        };
        let working = row.at_working_size(&full);
        assert_eq!((working.width, working.height), (1094, 729));
        let expected = [800.0, 802.0, 540.0, 364.8];
        for (found, expected) in numbers(&working).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
        }
        let back = working.unreduced(5, [5472, 3648]);
        assert!(are_equal(&back, &full), "{back:?}");
        // As an earlier run had it for the field, at a seventh.
        let reduced = full.box_reduced(7);
        assert_eq!((reduced.width, reduced.height), (781, 521));
        let found = row.at_working_size(&reduced);
        assert!(are_equal(&found, &working), "{found:?}");
        // Of another size than any that boxes leave.
        let resized = row.at_working_size(&full.resized(4000, 3000));
        assert_eq!((resized.width, resized.height), (1094, 729));
    }
}
