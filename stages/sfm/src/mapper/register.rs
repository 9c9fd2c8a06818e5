//! Registration of photos: which comes next, and whether it is kept.

use std::collections::BTreeMap;

use marf_sfm_features::estimators::{PointObservation, Resection, resect};
use marf_sfm_features::two_view::FocalKnown;

use super::global_adjustment::{COARSE, adjust_local, refine};
use super::initial_pair;
use super::input::{MIN_PHOTOS, MapError, MapperInput};
use super::model::Model;

/// Observations of triangulated points that a photo needs to be tried.
const MIN_VISIBLE: usize = 20;
/// Smallest number of inliers of its pose, and their smallest share.
const MIN_INLIERS: usize = 15;
const MIN_INLIER_SHARE: f64 = 0.25;
/// Factor on the largest reprojection error while a pose is estimated (COLMAP: 12 px and 4 px).
const RESECTION_SLACK: f64 = 3.0;
/// Factor on the number of photos at which the whole model is adjusted again.
const GROWTH: f64 = 1.15;
/// Photos that are adjusted with a new one: those that share most points with it.
const NEIGHBOURS: usize = 6;
/// Photos of other models that a model may register, so that both can be merged.
const MAX_SHARED: usize = 10;
/// Number of times a photo is tried.
const TRIES: u32 = 3;
/// Initial pairs tried before the largest model is taken.
const STARTS: usize = 3;
/// Factors tried on a guessed focal length whose camera has no photo in the model yet.
const FOCAL_FACTORS: [f64; 5] = [1.0, 0.7, 1.4, 0.5, 2.0];

/// Returns the largest model found of photos not taken. `None` if no pair can start one.
pub(super) fn largest_model(input: &MapperInput<'_>, taken: &[bool]) -> Result<Option<Model>, MapError> {
    let size = |model: &Model| model.photos().filter(|&photo| !taken[photo]).count();
    let mut best: Option<Model> = None;
    let mut tried_starts = 0;
    for link in initial_pair::candidates(input, taken) {
        input.check_stop()?;
        let known = |best: &Model| link.photos.iter().any(|&photo| best.poses[photo].is_some());
        if best.as_ref().is_some_and(known) {
            continue;
        }
        let Some(model) = initial_pair::initial_model(input, link)? else {
            continue;
        };
        let model = register_all(input, model, taken)?;
        if best.as_ref().is_none_or(|best| size(&model) > size(best)) {
            best = Some(model);
        }
        tried_starts += 1;
        let reachable = reachable(input, link.photos[0], taken);
        let enough = best.as_ref().is_some_and(|best| 2 * size(best) >= reachable);
        if enough || tried_starts >= STARTS {
            break;
        }
    }
    Ok(best.filter(|model| model.photos().count() >= MIN_PHOTOS.min(input.views.len())))
}

/// Returns the number of photos not taken that are connected to a photo.
fn reachable(input: &MapperInput<'_>, from: usize, taken: &[bool]) -> usize {
    let mut visited = vec![false; taken.len()];
    let mut open = vec![from];
    while let Some(photo) = open.pop() {
        if std::mem::replace(&mut visited[photo], true) {
            continue;
        }
        let links = input.links.iter().filter(|link| link.photos.contains(&photo));
        let others = links.map(|link| link.photos[0] + link.photos[1] - photo);
        open.extend(others.filter(|&other| !visited[other] && !taken[other]));
    }
    visited.iter().filter(|visited| **visited).count()
}

/// Number of attempts and points visible at the last one, of photos that did not fit.
#[derive(Default)]
struct Attempts(BTreeMap<usize, (u32, usize)>);

impl Attempts {
    /// Whether a photo may be tried: again only if it sees a tenth more points than at the last attempt.
    fn allows(&self, photo: usize, visible: usize) -> bool {
        self.0
            .get(&photo)
            .is_none_or(|&(tries, last)| tries < TRIES && visible * 10 > last * 11)
    }

    /// Records a failed attempt.
    fn note(&mut self, photo: usize, visible: usize) {
        let entry = self.0.entry(photo).or_default();
        *entry = (entry.0 + 1, visible);
    }
}

/// Returns a model to which photos were added one by one until none fitted. Then all is adjusted and each is tried again.
pub(super) fn register_all(
    input: &MapperInput<'_>,
    mut model: Model,
    taken: &[bool],
) -> Result<Model, MapError> {
    let mut attempts = Attempts::default();
    // Photos of the model when all of it was adjusted last, and when none fitted last.
    let (mut adjusted, mut stable) = (model.photos().count(), 0);
    loop {
        input.check_stop()?;
        let placed = model.photos().count();
        let Some((photo, visible)) = next_photo(input, &model, taken, &attempts) else {
            if placed == stable {
                return Ok(model);
            }
            refine(input, &mut model, &[], COARSE)?;
            adjusted = model.photos().count();
            (stable, attempts) = (placed, Attempts::default());
            continue;
        };
        if !register(input, &mut model, photo)? {
            attempts.note(photo, visible);
            continue;
        }
        (input.registered)(placed + 1);
        if (placed + 1) as f64 >= GROWTH * adjusted as f64 {
            refine(input, &mut model, &[], COARSE)?;
            adjusted = model.photos().count().max(placed);
        }
    }
}

/// Returns the photo with the highest visibility score and its number of visible points, the first on ties.
fn next_photo(
    input: &MapperInput<'_>,
    model: &Model,
    taken: &[bool],
    attempts: &Attempts,
) -> Option<(usize, usize)> {
    let shared = model.photos().filter(|&photo| taken[photo]).count();
    let open = |photo: &usize| model.poses[*photo].is_none() && !(taken[*photo] && shared >= MAX_SHARED);
    let candidates = (0..input.views.len()).filter(open).filter_map(|photo| {
        let visible = visible(input, model, photo);
        (visible.len() >= MIN_VISIBLE && attempts.allows(photo, visible.len()))
            .then(|| (visibility_score(input, photo, &visible), photo, visible.len()))
    });
    let best = candidates.max_by_key(|&(score, photo, _)| (score, std::cmp::Reverse(photo)));
    best.map(|(_, photo, visible)| (photo, visible))
}

/// Returns the observations of a photo whose track has a point.
fn visible(input: &MapperInput<'_>, model: &Model, photo: usize) -> Vec<usize> {
    let known =
        |observation: &usize| model.points[input.tracks.observations[*observation].track as usize].is_some();
    input.tracks.in_photo(photo).filter(known).collect()
}

/// Returns the visibility score: the occupied cells of grids of 2, 4 and 8 cells a side. Each is weighted by the
/// number of cells of its grid (Schönberger and Frahm 2016).
fn visibility_score(input: &MapperInput<'_>, photo: usize, observations: &[usize]) -> usize {
    let camera = &input.cameras[input.views[photo].camera].camera;
    let score = |level: u32| {
        let side = 1_usize << level;
        let cell =
            |position: f64, size: u32| ((position / f64::from(size) * side as f64) as usize).min(side - 1);
        let mut occupied = vec![false; side * side];
        for &observation in observations {
            let pixel = &input.tracks.observations[observation].pixel;
            occupied[cell(pixel.y, camera.height) * side + cell(pixel.x, camera.width)] = true;
        }
        side * side * occupied.iter().filter(|cell| **cell).count()
    };
    (1..=3).map(score).sum()
}

/// Registers a photo and adjusts its neighbourhood. False if it does not fit.
fn register(input: &MapperInput<'_>, model: &mut Model, photo: usize) -> Result<bool, MapError> {
    let observations = visible(input, model, photo);
    let Some((resection, factor)) = pose_of(input, model, photo, &observations) else {
        return Ok(false);
    };
    let camera = &mut model.cameras[input.views[photo].camera];
    (camera.fx_px, camera.fy_px) = (camera.fx_px * factor, camera.fy_px * factor);
    model.poses[photo] = Some(resection.cam_from_world);
    for &inlier in &resection.inliers {
        model.active[inlier] = true;
    }
    model.complete(input, input.tracks.of_photos(&[photo]));
    let around = neighbours(input, model, photo);
    adjust_local(input, model, &around)?;
    model.filter(input, input.tracks.of_photos(&around));
    let held = model.active_in(input, photo).count();
    if held < MIN_INLIERS {
        model.remove(input, photo);
    }
    Ok(held >= MIN_INLIERS)
}

/// Returns the pose with most inliers, as indices of observations, and the factor on the focal length it was found with.
fn pose_of(
    input: &MapperInput<'_>,
    model: &Model,
    photo: usize,
    observations: &[usize],
) -> Option<(Resection, f64)> {
    let shared = &input.cameras[input.views[photo].camera];
    let first = model
        .photos()
        .all(|other| input.views[other].camera != input.views[photo].camera);
    let unknown = first && matches!(shared.focal, FocalKnown::Guessed);
    let factors = if unknown {
        &FOCAL_FACTORS[..]
    } else {
        &FOCAL_FACTORS[..1]
    };
    let tries = factors.iter().filter_map(|&factor| {
        let found = resection(input, model, photo, observations, factor)?;
        Some((found, factor))
    });
    let best = tries.fold(None, |best: Option<(Resection, f64)>, one| match best {
        Some(best) if best.0.inliers.len() >= one.0.inliers.len() => Some(best),
        _ => Some(one),
    });
    let enough = MIN_INLIERS.max((MIN_INLIER_SHARE * observations.len() as f64) as usize);
    best.filter(|(found, _)| found.inliers.len() >= enough)
}

/// Returns the resection of a photo with its focal length times a factor.
fn resection(
    input: &MapperInput<'_>,
    model: &Model,
    photo: usize,
    observations: &[usize],
    factor: f64,
) -> Option<Resection> {
    let mut camera = model.cameras[input.views[photo].camera];
    (camera.fx_px, camera.fy_px) = (camera.fx_px * factor, camera.fy_px * factor);
    let (mut tried, mut points) = (Vec::new(), Vec::new());
    for &observation in observations {
        let one = &input.tracks.observations[observation];
        if let (Some(world), Some(ray)) = (model.points[one.track as usize], camera.unproject(&one.pixel)) {
            tried.push(observation);
            points.push(PointObservation {
                plane: ray.xy(),
                world,
            });
        }
    }
    let max_error = RESECTION_SLACK * input.options.max_error_px / camera.fx_px;
    let mut found = resect(&points, max_error, input.options.seed ^ photo as u64)?;
    found
        .inliers
        .iter_mut()
        .for_each(|inlier| *inlier = tried[*inlier]);
    Some(found)
}

/// Returns the photo and those that share most points with it, the first on ties.
pub(super) fn neighbours(input: &MapperInput<'_>, model: &Model, photo: usize) -> Vec<usize> {
    let mut shared = vec![0_usize; input.views.len()];
    for observation in model.active_in(input, photo) {
        let track = input.tracks.observations[observation].track as usize;
        let active = input.tracks.range(track).filter(|&other| model.active[other]);
        active.for_each(|other| shared[input.tracks.observations[other].photo as usize] += 1);
    }
    shared[photo] = 0;
    let mut others: Vec<usize> = (0..shared.len()).filter(|&other| shared[other] > 0).collect();
    others.sort_by_key(|&other| (std::cmp::Reverse(shared[other]), other));
    others.truncate(NEIGHBOURS);
    others.push(photo);
    others.sort_unstable();
    others
}
