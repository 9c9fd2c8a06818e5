//! Features of every photo, computed or from the memo.

use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::{Digest, digest_of};
use marf_scene::{Camera, Image, Pose, Srgb};
use marf_schema::calibrate::{CalibrateParams, FirstOctaveParam};
use marf_sfm_features::features::{FeatureOptions, Features, FirstOctave, Gray, Mask, extract_until};
use marf_stage::{Ctx, Inputs, StageError};
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::labels::{Candidate, Pixels, ideal, photo_key};
use crate::mask_files::undistorted_mask;
use crate::photos::{InputPhoto, as_png, decode, kept, store};

/// Raised when features, working images or label cameras may change.
const VERSION: u32 = 1;

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
                (image, file) = (store(ctx, item, &ideal.image)?, Some(as_png(&item.facts.file)));
            }
            ideal.image
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
    let features = extract_until(
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
        ..FeatureOptions::default()
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
