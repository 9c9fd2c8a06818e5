//! The stage: its declaration, its outputs, and what makes a result too poor.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_scene::{Frame, PosedPhoto, Scene, Unplaced, hold_out_more_places};
use marf_schema::calibrate::{CalibrateParams, Hold, Method, Metrics, PhotoMetrics, Totals};
use marf_schema::output::{POINTS, SCENE, SPARSE, SPARSE_IMAGES, SPARSE_POINTS, TRANSFORMS};
use marf_schema::rigs;
use marf_sfm::rigs::{RigVerdict, StereoPair};
use marf_stage::{COMPANIONS, Ctx, Document, Inputs, Outputs, PHOTOS, Port, Set, StageError, Threads, stage};

use crate::calibration::{Calibration, HeldOut, PlacedPhoto};
use crate::export::{TrackPoint, Tracks, beside, write_colmap, write_ply, write_transforms};
use crate::mask_files::field_masks;
use crate::orientation::Orientation;
use crate::photos::{InputPhoto, as_png, load, reduced, size_px};
use crate::{import, labels, sfm};

/// Returns the camera of each photo, as a scene.
///
/// - In: the photos. `import` also reads the files next to them, `sfm` the masks among these. With `extend`, its own last scene.
/// - Out: `scene`, `metrics`, and the scene for other programs: `transforms`, `sparse/0/….bin`, `points.ply`.
/// - Cost: `sfm` takes about 0.2 CPU s a photo of 2.8 megapixels for 98 of them (`benches/calibrate.md`) and keeps the results of photos
///   and pairs. `labels` decodes, resamples and encodes each photo once, at most 0.4 s a megapixel and core for CAHVOR, 0.6 s for CAHVORE.
///   `import` reads photos only to find points in them or for a smaller `longest_side_px`.
/// - Bad input: a photo that cannot be placed, or whose camera in a file cannot be used, is listed with the reason. A camera file that
///   cannot be read is refused, with the field. Too few placed photos stop the node.
pub struct Calibrate(CalibrateParams);

stage! {
    Calibrate { 0: CalibrateParams },
    Set,
    Threads::All,
    about: "photos to a calibrated scene: from what they show, from labels, or from imported cameras",
    version: 16,
    ports: [
        Port::required("input", PHOTOS),
        Port::optional("cameras", COMPANIONS),
    ],
    outputs: [
        SCENE,
        Metrics::OUTPUT,
        TRANSFORMS,
        SPARSE,
        SPARSE_IMAGES,
        SPARSE_POINTS,
        POINTS,
    ],
    {
        fn earlier(&self) -> Option<&'static str> {
            self.0.extend.then_some(SCENE)
        }
    },
}

impl Set for Calibrate {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let items = load(ctx, inputs)?;
        let params = &self.resolved(ctx, inputs)?;
        let mut found = match params.method {
            Method::Labels => labels::run(ctx, &items, params)?,
            Method::Import => import::run(ctx, inputs, &items, params)?,
            Method::Sfm | Method::Auto => sfm::run(ctx, inputs, &items, params)?,
        };
        check_enough(&found, items.len(), params.min_registered)?;
        hold_out(
            &mut found,
            params,
            &items,
            sfm::earlier_scene(ctx, inputs)?.as_ref(),
        );
        check_training(&found.placed)?;
        let metrics = metrics(&found, &items);
        for one in &mut found.placed {
            store_as_placed(ctx, one, &items[one.item])?;
        }
        let tracks = std::mem::take(&mut found.tracks);
        let masks = field_masks(ctx, inputs, &items, &found.placed, params)?;
        let mut scene = scene(found, &items, &masks);
        let tracks = if tracks.is_empty() {
            Tracks::without_observations(&scene.points)
        } else {
            of_frames(tracks, &scene, &items)
        };
        scene.tones = tracks.tones(&scene);
        let failed = |error: &dyn std::fmt::Display| StageError::new(error.to_string());
        let bytes = scene.encode().map_err(|error| failed(&error))?;
        let metrics = metrics.encode().map_err(|error| failed(&error))?;
        let outputs = [
            (SCENE, bytes),
            (Metrics::OUTPUT, metrics),
            (
                TRANSFORMS,
                write_transforms(&scene, &beside, &|_| None).into_bytes(),
            ),
            (POINTS, write_ply(&tracks)),
        ];
        let outputs = outputs.map(|(name, bytes)| (name.to_owned(), bytes));
        let model = write_colmap(&scene, &tracks).map(|(name, bytes)| (format!("{SPARSE}0/{name}"), bytes));
        let stored = outputs.into_iter().chain(model);
        stored.map(|(name, bytes)| Ok((name, ctx.put(&bytes)?))).collect()
    }
}

impl Calibrate {
    /// Returns the parameters with `auto` resolved to a method.
    fn resolved(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<CalibrateParams, StageError> {
        let method = match self.0.method {
            Method::Auto if import::has_cameras(ctx, inputs)? => Method::Import,
            Method::Auto => Method::Sfm,
            method => method,
        };
        Ok(CalibrateParams {
            method,
            ..self.0.clone()
        })
    }
}

/// Makes the image of a photo one whose pixels every program opens as the camera has them. A photo with an EXIF orientation is stored
/// upright as PNG, and a developed one is named as the PNG that it is.
fn store_as_placed(ctx: &Ctx<'_>, one: &mut PlacedPhoto, item: &InputPhoto) -> Result<(), StageError> {
    if one.image != item.image {
        return Ok(());
    }
    if item.orientation() != Orientation::UPRIGHT {
        let size_px = size_px(ctx, item)?;
        one.image = reduced(ctx, &item.id, &item.image, size_px, 1)?;
        one.file = as_png(&one.file);
    } else if item.developed {
        one.file = as_png(&one.file);
    }
    Ok(())
}

/// Refuses a scene of too few photos, with the most common reason.
fn check_enough(found: &Calibration, total: usize, min_registered: u32) -> Result<(), StageError> {
    let placed = found.placed.len();
    if placed > 0 && placed >= min_registered as usize {
        return Ok(());
    }
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for (_, reason) in &found.unplaced {
        *reasons.entry(reason).or_default() += 1;
    }
    let most_common = reasons.into_iter().max_by_key(|(_, count)| *count);
    let most_common = most_common.map(|(reason, count)| format!("{count} photos: {reason}"));
    let error = StageError::new(format!(
        "{placed} of {total} photos were placed, and `min_registered` asks for {min_registered}"
    ))
    .hint(found.hint.clone());
    Err(match found.cause.clone().or(most_common) {
        Some(cause) => error.cause(cause),
        None => error,
    })
}

/// Sorts photos by file name and holds some out, unless the import has decided. Photos of the earlier scene stay as they were there.
fn hold_out(
    found: &mut Calibration,
    params: &CalibrateParams,
    items: &[InputPhoto],
    earlier: Option<&Scene>,
) {
    found
        .placed
        .sort_by(|a, b| (&a.file, a.item).cmp(&(&b.file, b.item)));
    if found.placed.iter().any(|one| one.held_out.is_some()) {
        return;
    }
    let known = found.placed.iter().map(|one| {
        let frame = earlier?.frame(&items[one.item].id)?;
        Some(frame.held_out)
    });
    let known: Vec<Option<bool>> = known.collect();
    let held_out = match params.hold {
        Hold::Place => by_place(found, params.hold_every, items, &known),
        Hold::Every => every(params.hold_every as usize, &known),
    };
    for (one, held_out) in found.placed.iter_mut().zip(held_out) {
        one.held_out = Some(if held_out { HeldOut::Yes } else { HeldOut::No });
    }
}

fn by_place(found: &Calibration, every: u32, items: &[InputPhoto], known: &[Option<bool>]) -> Vec<bool> {
    let photos = found.placed.iter().map(|one| PosedPhoto {
        id: &items[one.item].id,
        camera: &one.camera,
        cam_from_world: &one.cam_from_world,
    });
    let photos: Vec<PosedPhoto<'_>> = photos.collect();
    hold_out_more_places(&photos, &found.points, every, known)
}

/// Returns which photos are held out at one in `every`, from the first on. `known` ones stay as they were.
fn every(every: usize, known: &[Option<bool>]) -> Vec<bool> {
    let is_held_out = |index: usize| every > 0 && known[index].unwrap_or(index.is_multiple_of(every));
    (0..known.len()).map(is_held_out).collect()
}

/// Refuses a scene without photos for training.
fn check_training(placed: &[PlacedPhoto]) -> Result<(), StageError> {
    if placed.iter().any(|one| one.held_out != Some(HeldOut::Yes)) {
        return Ok(());
    }
    Err(StageError::new(format!(
        "all {} placed photos are kept from training",
        placed.len()
    ))
    .hint("set `hold_every = 0`, or name photos in `train_filenames`"))
}

/// Returns the metrics of all photos.
fn metrics(found: &Calibration, items: &[InputPhoto]) -> Metrics {
    let mut photos: Vec<PhotoMetrics> = items.iter().map(unregistered).collect();
    for (photo, statistics) in photos.iter_mut().zip(&found.statistics) {
        (photo.features, photo.matches) = (statistics.features, statistics.matches);
    }
    for (index, reason) in &found.unplaced {
        photos[*index].reason.clone_from(reason);
    }
    for one in &found.placed {
        let photo = &mut photos[one.item];
        photo.registered = true;
        photo.held_out = one.held_out == Some(HeldOut::Yes);
        (photo.features, photo.matches, photo.inliers) = (
            one.statistics.features,
            one.statistics.matches,
            one.statistics.inliers,
        );
        (photo.error_px, photo.note) = (one.statistics.error_px, one.statistics.note.clone());
        photo.angle_sigma_deg = one.statistics.uncertainty.map(|one| one.angle_rad.to_degrees());
        photo.centre_sigma = one.statistics.uncertainty.map(|one| one.distance);
    }
    let mean =
        |errors: Vec<f64>| (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64);
    let working = found
        .placed
        .iter()
        .filter_map(|one| one.statistics.error_working_px);
    let totals = Totals {
        photos: items.len(),
        registered: found.placed.len(),
        held_out: photos.iter().filter(|photo| photo.held_out).count(),
        unplaced: found.unplaced.len(),
        missing: found.missing.len(),
        points: found.points.len(),
        components: found.components,
        error_px: mean(photos.iter().filter_map(|photo| photo.error_px).collect()),
        error_working_px: mean(working.collect()),
    };
    photos.sort_by(|a, b| a.id.cmp(&b.id));
    let stereo_pairs = found.stereo_pairs.iter().map(|pair| stereo_pair(pair, items));
    Metrics {
        method: found.method.clone(),
        totals,
        photos,
        missing: found.missing.clone(),
        tie: labels::tie(found, items),
        up: found.up.map(|found| found.up),
        stereo_pairs: stereo_pairs.collect(),
    }
}

/// Returns the metrics of a stereo pair.
fn stereo_pair(pair: &StereoPair, items: &[InputPhoto]) -> rigs::StereoPair {
    rigs::StereoPair {
        photos: pair.photos.map(|photo| items[photo].id.clone()),
        angle_deg: pair.angle_rad.to_degrees(),
        distance_m: pair.distance_m,
        verdict: match pair.verdict {
            RigVerdict::Rigid => rigs::Verdict::Rigid,
            RigVerdict::Differs => rigs::Verdict::Differs,
            RigVerdict::Unclear => rigs::Verdict::Unclear,
        },
    }
}

/// Returns the metrics of a photo that is not registered.
fn unregistered(item: &InputPhoto) -> PhotoMetrics {
    PhotoMetrics {
        id: item.id.clone(),
        file: item.facts.file.clone(),
        ..PhotoMetrics::default()
    }
}

/// Returns the scene of a calibration.
fn scene(found: Calibration, items: &[InputPhoto], masks: &BTreeMap<usize, Digest>) -> Scene {
    let frame = |one: PlacedPhoto| Frame {
        id: items[one.item].id.clone(),
        file: one.file,
        image: one.image,
        mask: masks.get(&one.item).copied(),
        camera: one.camera,
        cam_from_world: one.cam_from_world,
        held_out: one.held_out == Some(HeldOut::Yes),
        error_px: one.statistics.error_px,
    };
    let mut frames: Vec<Frame> = found.placed.into_iter().map(frame).collect();
    frames.sort_by(|a, b| a.id.cmp(&b.id));
    let unplaced = found.unplaced.into_iter().map(|(index, reason)| Unplaced {
        id: items[index].id.clone(),
        reason,
    });
    let mut unplaced: Vec<Unplaced> = unplaced.collect();
    unplaced.sort_by(|a, b| a.id.cmp(&b.id));
    Scene {
        frames,
        unplaced,
        points: found.points,
        up: found.up.map(|found| found.direction),
        metres_per_unit: found.metres_per_unit,
        site: found.site,
        tones: None,
        method: found.method,
    }
}

/// Returns the points with the frames of their observations as indices in the scene, whose frames are sorted by id.
fn of_frames(mut points: Vec<TrackPoint>, scene: &Scene, items: &[InputPhoto]) -> Tracks {
    let by_id = |item: &InputPhoto| scene.frames.binary_search_by(|frame| frame.id.cmp(&item.id)).ok();
    let frame_of: Vec<Option<usize>> = items.iter().map(by_id).collect();
    for observation in points.iter_mut().flat_map(|point| &mut point.observations) {
        // All observations are of photos of the scene. Another one would be an error of the method.
        observation.frame = frame_of[observation.frame as usize].map_or(u32::MAX, |frame| frame as u32);
    }
    Tracks { points }
}
