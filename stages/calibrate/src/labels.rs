//! Cameras from labels: every photo of one site in one metric frame, each an ideal pinhole.

use std::collections::BTreeMap;

use marf_cache::{Digest, digest_of};
use marf_numeric::upper_median;
use marf_scene::{Cahvor, Camera, CameraPrior, Image, Photo, Pinhole, Pose, SiteFrame, Srgb};
use marf_schema::calibrate::{CalibrateParams, Tie};
use marf_stage::{Ctx, StageError};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::calibration::{Calibration, PhotoStatistics, PlacedPhoto};
use crate::photos::{InputPhoto, as_png, decode, kept, reduction, store, with_other_grid};
use crate::resample::resample;
use crate::up::FoundUp;

/// A photo whose label can be used.
pub(crate) struct Candidate<'a> {
    item: usize,
    pub model: &'a Cahvor,
    pub site: Option<i64>,
    pub site_from_frame: Pose,
}

/// Image and camera of a photo, as a memo keeps them.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct PinholePhoto {
    image: Digest,
    file: String,
    camera: Camera,
    cam_from_site: Pose,
}

/// A photo as an ideal pinhole would take it.
pub(crate) struct IdealPhoto {
    pub photo: Photo,
    pub pixels: Pixels,
    pub camera: Camera,
    pub cam_from_site: Pose,
}

/// Where an ideal image's pixels come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pixels {
    /// From the photo itself.
    Own,
    /// Resampled with the lens of the label.
    Resampled,
}

/// Returns the photos of one site with the cameras of their labels. The world is x north, y east, z down, in metres, the origin at the
/// median of the cameras.
///
/// A photo whose model is an ideal pinhole already keeps its bytes. Every other one is resampled once.
pub(crate) fn run(
    ctx: &Ctx<'_>,
    items: &[InputPhoto],
    params: &CalibrateParams,
) -> Result<Calibration, StageError> {
    let mut unplaced = Vec::new();
    let mut candidates = Vec::new();
    for (index, item) in items.iter().enumerate() {
        match candidate(index, item) {
            Ok(candidate) => candidates.push(candidate),
            Err(reason) => unplaced.push((index, reason)),
        }
    }
    let site = chosen_site(&candidates, params.site);
    let (here, elsewhere) = candidates
        .into_iter()
        .partition::<Vec<_>, _>(|candidate| candidate.site == site);
    unplaced.extend(
        elsewhere
            .iter()
            .map(|candidate| (candidate.item, other_site(candidate.site, site))),
    );
    let made = make_all(ctx, items, &here, params)?;
    let mut placed = Vec::new();
    for (candidate, made) in here.iter().zip(made) {
        match made {
            Ok(made) => placed.push(place(candidate.item, made)),
            Err(reason) => unplaced.push((candidate.item, reason)),
        }
    }
    let origin = centre(&mut placed);
    Ok(Calibration {
        placed,
        unplaced,
        up: Some(FoundUp::labels()),
        metres_per_unit: Some(1.0),
        site: site.map(|site| SiteFrame {
            site,
            origin_m: origin.into(),
        }),
        method: "labels: resampled once to an ideal pinhole, cubic in 8-bit sRGB".to_owned(),
        hint: "take an archive whose labels hold camera models, choose another `site`, widen `sols`, or use \
               `method = \"import\"`"
            .to_owned(),
        ..Calibration::default()
    })
}

/// Returns the usable label of a photo, or the reason why it has none.
pub(crate) fn candidate(index: usize, item: &InputPhoto) -> Result<Candidate<'_>, String> {
    let Some(prior) = &item.facts.prior else {
        return Err(no_prior(item));
    };
    Ok(Candidate {
        item: index,
        model: &prior.model,
        site: prior.motion_counter.first().copied(),
        site_from_frame: site_from_frame(prior)?,
    })
}

/// Returns the label of each photo that can be used and is of the chosen site, by default that with most photos.
pub(crate) fn of_one_site(items: &[InputPhoto], site: Option<i64>) -> Vec<Option<Candidate<'_>>> {
    let candidates = items
        .iter()
        .enumerate()
        .filter_map(|(index, item)| candidate(index, item).ok());
    let candidates: Vec<Candidate<'_>> = candidates.collect();
    let site = chosen_site(&candidates, site);
    let mut by_item: Vec<Option<Candidate<'_>>> = items.iter().map(|_| None).collect();
    for candidate in candidates.into_iter().filter(|candidate| candidate.site == site) {
        let item = candidate.item;
        by_item[item] = Some(candidate);
    }
    by_item
}

/// Returns the requested site, or that with most photos.
fn chosen_site(candidates: &[Candidate<'_>], asked: Option<i64>) -> Option<i64> {
    asked.map_or_else(|| site_with_most_photos(candidates), Some)
}

/// Returns why a photo has no camera from its label.
fn no_prior(item: &InputPhoto) -> String {
    let said = item.facts.notes.iter().find(|note| note.starts_with("label"));
    match (said, item.labelled) {
        (Some(note), _) => format!("label without camera ({note})"),
        (None, true) => "label without camera".to_owned(),
        (None, false) => "no label".to_owned(),
    }
}

/// Returns the pose of the label's frame in its site.
fn site_from_frame(prior: &CameraPrior) -> Result<Pose, String> {
    match prior.site_from_frame {
        Some(pose) if pose.is_valid() => Ok(pose),
        Some(_) => Err(format!(
            "label's pose of {} in its site is not a rotation",
            prior.frame
        )),
        None if prior.frame.starts_with("SITE") => Ok(Pose::identity()),
        None => Err(format!("label does not say where {} is in its site", prior.frame)),
    }
}

/// Returns the site with most photos. Of equals the first is taken.
fn site_with_most_photos(candidates: &[Candidate<'_>]) -> Option<i64> {
    let mut counts: BTreeMap<Option<i64>, usize> = BTreeMap::new();
    for candidate in candidates {
        *counts.entry(candidate.site).or_default() += 1;
    }
    let most = counts.values().max().copied()?;
    counts.into_iter().find(|(_, count)| *count == most)?.0
}

/// Returns why a photo of another site is not placed.
fn other_site(own: Option<i64>, chosen: Option<i64>) -> String {
    let name = |site: Option<i64>| site.map_or("unknown".to_owned(), |site| site.to_string());
    match own {
        Some(site) => format!(
            "of site {site}, but this scene is of site {} (`site = {site}` builds it)",
            name(chosen)
        ),
        None => format!("label names no site, and this scene is of site {}", name(chosen)),
    }
}

/// Returns image and camera of each candidate, or the reason why it has none.
fn make_all(
    ctx: &Ctx<'_>,
    items: &[InputPhoto],
    candidates: &[Candidate<'_>],
    params: &CalibrateParams,
) -> Result<Vec<Result<PinholePhoto, String>>, StageError> {
    let done = std::sync::atomic::AtomicU64::new(0);
    let all = candidates.par_iter().map(|candidate| {
        ctx.check()?;
        let made = known_or_made(ctx, &items[candidate.item], candidate, params);
        let so_far = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
        ctx.progress
            .at(so_far, candidates.len() as u64, "photos resampled");
        made
    });
    all.collect()
}

/// Returns the digest of everything that the image of a photo for the pinhole of its label depends on, and of its mask.
pub(crate) fn photo_key(
    item: &InputPhoto,
    candidate: Option<&Candidate<'_>>,
    mask: Option<Digest>,
) -> Digest {
    let model = candidate.map(|candidate| {
        (
            candidate.model,
            candidate.site_from_frame,
            item.facts.width,
            item.facts.height,
        )
    });
    let text = serde_json::to_vec(&(item.image, model, mask, &item.facts.file)).unwrap_or_default();
    Digest::from_content(&text)
}

/// Returns the result of [`make`] for a photo. That of an earlier run is taken from the memo.
fn known_or_made(
    ctx: &Ctx<'_>,
    item: &InputPhoto,
    candidate: &Candidate<'_>,
    params: &CalibrateParams,
) -> Result<Result<PinholePhoto, String>, StageError> {
    let depends_on = photo_key(item, Some(candidate), None);
    let key = digest_of(&("calibrate label photo 2", depends_on, params.longest_side_px));
    let known = ctx.memos.load(&key).and_then(|bytes| {
        let known: Result<PinholePhoto, String> = serde_json::from_slice(&bytes).ok()?;
        let image = known.as_ref().ok().map(|known| known.image);
        image.is_none_or(|image| kept(ctx, &image)).then_some(known)
    });
    if let Some(known) = known {
        return Ok(known);
    }
    let made = make(ctx, item, candidate, params)?;
    let bytes = serde_json::to_vec(&made).map_err(|error| StageError::new(error.to_string()))?;
    ctx.memos.save(&key, &bytes);
    Ok(made)
}

/// Returns image and camera of a photo at the size that the field is trained on.
fn make(
    ctx: &Ctx<'_>,
    item: &InputPhoto,
    candidate: &Candidate<'_>,
    params: &CalibrateParams,
) -> Result<Result<PinholePhoto, String>, StageError> {
    let ideal = match ideal(ctx, item, candidate)? {
        Ok(ideal) => ideal,
        Err(reason) => return Ok(Err(reason)),
    };
    let factor = reduction(ideal.camera.width, ideal.camera.height, params.longest_side_px);
    let (image, file) = if ideal.pixels == Pixels::Own && factor == 1 {
        (item.image, item.facts.file.clone())
    } else {
        (
            store(ctx, item, &ideal.photo.box_reduced(factor))?,
            as_png(&item.facts.file),
        )
    };
    Ok(Ok(PinholePhoto {
        image,
        file,
        camera: ideal.camera.box_reduced(factor),
        cam_from_site: ideal.cam_from_site,
    }))
}

/// Returns a photo resampled, if needed, to the pinhole of its label, or why that is not possible.
pub(crate) fn ideal(
    ctx: &Ctx<'_>,
    item: &InputPhoto,
    candidate: &Candidate<'_>,
) -> Result<Result<IdealPhoto, String>, StageError> {
    undistorted(ctx, decode(ctx, item)?, item, candidate)
}

/// Returns a mask resampled as its photo by [`ideal`]. Where the photo's edge is repeated, so is the mask's.
pub(crate) fn ideal_mask(
    ctx: &Ctx<'_>,
    mask: Image<Srgb>,
    item: &InputPhoto,
    candidate: &Candidate<'_>,
) -> Result<Image<Srgb>, StageError> {
    let found = undistorted(ctx, mask.clone().into(), item, candidate)?;
    Ok(found.map_or(mask, |ideal| ideal.photo.image))
}

fn undistorted(
    ctx: &Ctx<'_>,
    photo: Photo,
    item: &InputPhoto,
    candidate: &Candidate<'_>,
) -> Result<Result<IdealPhoto, String>, StageError> {
    let (width, height) = (photo.image.width, photo.image.height);
    let labelled = (item.facts.width, item.facts.height);
    if labelled != (0, 0) && labelled != (width, height) {
        return Ok(Err(format!(
            "label's camera is for {} x {} pixels, the photo has {width} x {height}",
            labelled.0, labelled.1
        )));
    }
    let (pinhole, undistortion) = match pinhole(candidate.model, width, height) {
        Ok(found) => found,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let (photo, pixels) = match undistortion {
        Undistortion::None => (photo, Pixels::Own),
        Undistortion::Resample(model) => {
            match with_other_grid(photo, |pixels| resample(pixels, &model, &pinhole, ctx.cancel)) {
                Ok(photo) => (photo, Pixels::Resampled),
                Err(Some(error)) => return Ok(Err(error.to_string())),
                Err(None) => return Err(StageError::Cancelled),
            }
        }
    };
    Ok(Ok(IdealPhoto {
        photo,
        pixels,
        camera: pinhole.camera,
        cam_from_site: pinhole.cam_from_frame * candidate.site_from_frame.inverse(),
    }))
}

/// How a photo becomes that of an ideal pinhole.
enum Undistortion {
    /// It already is.
    None,
    /// By resampling with this model (normalised).
    Resample(Cahvor),
}

/// Returns the pinhole of a camera model, and how photos become its.
fn pinhole(
    model: &Cahvor,
    width: u32,
    height: u32,
) -> Result<(Pinhole, Undistortion), marf_scene::CahvorError> {
    if let Some(pinhole) = model.exact_pinhole(width, height)? {
        return Ok((pinhole, Undistortion::None));
    }
    let pinhole = model.linearised(width, height)?;
    Ok((pinhole, Undistortion::Resample(model.normalised()?)))
}

/// Returns a placed photo.
fn place(item: usize, made: PinholePhoto) -> PlacedPhoto {
    PlacedPhoto {
        item,
        file: made.file,
        image: made.image,
        mask: None,
        camera: made.camera,
        cam_from_world: made.cam_from_site,
        held_out: None,
        statistics: PhotoStatistics::default(),
    }
}

/// Moves the origin to the median of the camera centres, axis by axis, so that f32 coordinates stay precise, and returns where it was.
fn centre(placed: &mut [PlacedPhoto]) -> Vector3<f64> {
    let centres: Vec<Vector3<f64>> = placed.iter().map(|one| one.cam_from_world.centre()).collect();
    let site_from_world = Pose {
        translation: median(&centres),
        ..Pose::identity()
    };
    for one in placed {
        one.cam_from_world = one.cam_from_world * site_from_world;
    }
    site_from_world.translation
}

/// Returns how far cameras are from where the labels of their site put them. `None` if the world is not tied to a site.
pub(crate) fn tie(found: &Calibration, items: &[InputPhoto]) -> Option<Tie> {
    let SiteFrame { site, origin_m } = found.site?;
    let off = found.placed.iter().filter_map(|one| {
        let label = candidate(one.item, &items[one.item]).ok()?;
        let centre = one.cam_from_world.centre() + Vector3::from(origin_m);
        let labelled = label.site_from_frame.point(&Vector3::from(label.model.c));
        (label.site == Some(site)).then(|| (centre - labelled).norm())
    });
    let off: Vec<f64> = off.collect();
    Some(Tie {
        site,
        photos: off.len(),
        median_m: upper_median(off.iter().copied())?,
        largest_m: off.into_iter().max_by(f64::total_cmp)?,
    })
}

/// Returns the median of points, axis by axis. Without points it is the origin.
pub(crate) fn median(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| upper_median(points.iter().map(|point| point[axis])).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use marf_scene::PhotoFacts;
    use marf_stage::harness::Harness;

    use super::*;

    #[test]
    fn a_photo_for_the_pinhole_of_its_label_is_as_transparent_as_before() {
        let harness = Harness::default();
        let photo = Photo {
            alpha: vec![128; 64 * 48],
            ..Photo::from(Image::<Srgb>::from_fn(64, 48, |_, _| [50; 3]))
        };
        let image = harness.put(&photo.to_png().unwrap());
        for radial in [0.0, 0.5] {
            let model = Cahvor {
                c: [0.0; 3],
                a: [0.0, 0.0, 1.0],
                h: [50.0, 0.0, 32.0],
                v: [0.0, 50.0, 24.0],
                o: Some([0.0, 0.0, 1.0]),
                r: Some([0.0, radial, 0.0]),
                e: None,
            };
            let facts = PhotoFacts {
                width: 64,
                height: 48,
                prior: Some(CameraPrior {
                    model,
                    frame: "SITE_FRAME".to_owned(),
                    site_from_frame: None,
                    motion_counter: vec![1],
                }),
                ..PhotoFacts::default()
            };
            let item = InputPhoto::new("a".to_owned(), image, facts);
            let label = candidate(0, &item).unwrap();
            for longest_side_px in [None, Some(32)] {
                let params = CalibrateParams {
                    longest_side_px,
                    ..CalibrateParams::default()
                };
                let made = make(&harness.ctx(), &item, &label, &params).unwrap().unwrap();
                let found = Photo::decode(&harness.get(&made.image).unwrap()).unwrap();
                assert_eq!(found.image.width, made.camera.width);
                let is_kept = found.alpha == vec![128; found.image.pixels.len()];
                assert!(is_kept, "{radial} {longest_side_px:?}");
            }
        }
    }
}
