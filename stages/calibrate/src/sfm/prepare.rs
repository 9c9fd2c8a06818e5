use std::sync::atomic::{AtomicU64, Ordering};

use marf_cache::{ContentHash, Digest, digest_of};
use marf_scene::{Camera, Image, Pose, Srgb};
use marf_stage::{Ctx, Inputs, StageError};
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::table::Table;
use crate::features::{FeatureOptions, Features, FirstOctave, Gray, Mask, extract};
use crate::labels::{Candidate, Pixels, ideal};
use crate::masks::mask_file;
use crate::params::{CalibrateParams, FirstOctaveParam};
use crate::photos::{Item, as_png, decode, store};

/// Raised when features, working images or label cameras may come out differently.
const VERSION: u32 = 1;

/// A photo with all that is known of it before it is compared with others.
pub(super) struct Prepared {
    pub row: Row,
    pub features: Features,
    /// sRGB under each feature.
    pub colors: Vec<[u8; 3]>,
}

impl Prepared {
    /// Positions of its features, pixels of the working size.
    pub(super) fn pixels(&self) -> Vec<Vector2<f64>> {
        let points = self.features.keypoints.iter();
        points
            .map(|point| Vector2::new(f64::from(point.x_px), f64::from(point.y_px)))
            .collect()
    }
}

/// What is kept of a photo from run to run, beside its features.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Row {
    /// The image the frame will name: the photo's own, or the one resampled through its label's model.
    pub image: Digest,
    /// Another file name, if the image is another.
    pub file: Option<String>,
    pub width: u32,
    pub height: u32,
    /// By how much the working size is smaller.
    pub factor: u32,
    /// Camera of that image and pose in its site, from the label.
    pub label: Option<(Camera, Pose)>,
    /// Why the label could not be used.
    pub note: Option<String>,
    /// Digest of what was found in it: names it in the keys of pairs.
    pub found: Digest,
}

/// What is known of one photo.
struct Found {
    row: Row,
    features: Features,
    colors: Vec<[u8; 3]>,
}

#[derive(ContentHash)]
struct MemoKey {
    what: &'static str,
    version: u32,
    max_features: u32,
    feature_side_px: u32,
    first_octave: FirstOctaveParam,
}

/// Decodes each photo, resamples it if its label's lens is no pinhole, and finds its features; what an earlier
/// run found is taken from the memo.
pub(super) fn prepare(
    ctx: &Ctx<'_>,
    inputs: &Inputs,
    items: &[Item],
    candidates: &[Option<Candidate<'_>>],
    params: &CalibrateParams,
) -> Result<Vec<Prepared>, StageError> {
    let key = digest_of(&MemoKey {
        what: "calibrate features",
        version: VERSION,
        max_features: params.max_features,
        feature_side_px: params.feature_side_px,
        first_octave: params.first_octave,
    });
    let mut table = Table::load(ctx, &key);
    let done = AtomicU64::new(0);
    let prepared: Vec<Result<(Digest, Prepared), StageError>> = (0..items.len())
        .into_par_iter()
        .map(|item| {
            ctx.check()?;
            let mask = mask_file(ctx, inputs, &items[item])?;
            let candidate = candidates[item].as_ref();
            let name = row_key(&items[item], candidate, mask.as_ref());
            let kept = table.get(&name).and_then(|row| recall(ctx, row));
            let Found {
                row,
                features,
                colors,
            } = match kept {
                Some(kept) => kept,
                None => found(ctx, &items[item], candidate, mask.as_ref(), params)?,
            };
            let so_far = done.fetch_add(1, Ordering::Relaxed) + 1;
            ctx.progress
                .at(so_far, items.len() as u64, "photos searched for features");
            Ok((
                name,
                Prepared {
                    row,
                    features,
                    colors,
                },
            ))
        })
        .collect();
    for (name, one) in prepared.iter().flatten() {
        table.insert(name, serde_json::to_vec(&one.row).unwrap_or_default());
    }
    table.save(ctx, &key);
    prepared.into_iter().map(|one| one.map(|(_, one)| one)).collect()
}

/// All that a row depends on beside the memo's key.
fn row_key(item: &Item, candidate: Option<&Candidate<'_>>, mask: Option<&Image<Srgb>>) -> Digest {
    let model = candidate.map(|candidate| {
        (
            candidate.model,
            candidate.site_from_frame,
            item.facts.width,
            item.facts.height,
        )
    });
    let mask = mask.map(|mask| Digest::of(mask.pixels.as_flattened()));
    let text = serde_json::to_vec(&(item.image, model, mask, &item.facts.file)).unwrap_or_default();
    Digest::of(&text)
}

fn recall(ctx: &Ctx<'_>, row: &[u8]) -> Option<Found> {
    let row: Row = serde_json::from_slice(row).ok()?;
    if row.file.is_some() {
        // The resampled image must still be there: the frame will name it.
        ctx.get(&row.image).ok()?;
    }
    let (features, colors) = unpack(&ctx.get(&row.found).ok()?)?;
    Some(Found {
        row,
        features,
        colors,
    })
}

/// Searches the photo itself, or the pinhole image its label makes of it.
fn found(
    ctx: &Ctx<'_>,
    item: &Item,
    candidate: Option<&Candidate<'_>>,
    mask: Option<&Image<Srgb>>,
    params: &CalibrateParams,
) -> Result<Found, StageError> {
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
    let features = extract(
        &Gray::of(&photo, factor),
        &Mask::of(&photo, factor, mask),
        &options(params),
    );
    let points = features.keypoints.iter();
    let colors: Vec<[u8; 3]> = points
        .map(|point| color(&photo, factor, point.x_px, point.y_px))
        .collect();
    let row = Row {
        image,
        file,
        width: photo.width,
        height: photo.height,
        factor,
        label,
        note,
        found: ctx.put(&pack(&features, &colors))?,
    };
    Ok(Found {
        row,
        features,
        colors,
    })
}

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

fn color(photo: &Image<Srgb>, factor: u32, x_px: f32, y_px: f32) -> [u8; 3] {
    let at = |position: f32, size: u32| ((position * factor as f32) as u32).min(size.saturating_sub(1));
    photo.at(at(x_px, photo.width), at(y_px, photo.height))
}

/// Colours after the features, three bytes each.
fn pack(features: &Features, colors: &[[u8; 3]]) -> Vec<u8> {
    let features = features.encode();
    let mut bytes = (features.len() as u64).to_le_bytes().to_vec();
    bytes.extend(features);
    bytes.extend(colors.as_flattened());
    bytes
}

fn unpack(bytes: &[u8]) -> Option<(Features, Vec<[u8; 3]>)> {
    let (len, rest) = bytes.split_first_chunk::<8>()?;
    let (features, colors) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*len)).ok()?)?;
    let features = Features::decode(features)?;
    let (colors, torn) = colors.as_chunks::<3>();
    (torn.is_empty() && colors.len() == features.keypoints.len()).then(|| (features, colors.to_vec()))
}
