use std::collections::BTreeMap;

use super::refine::{ROUGH, adjust_local, settle};
use super::{MIN_PHOTOS, MapError, Model, Task, start};
use crate::estimators::{Resection, Seen, resect};
use crate::two_view::FocalKnown;

/// Sights of known points a photo needs to be tried.
const MIN_VISIBLE: usize = 20;
/// Sights that must agree on its pose, and their share of those tried.
const MIN_INLIERS: usize = 15;
const MIN_INLIER_SHARE: f64 = 0.25;
/// How much farther than a kept sight a point may appear while a pose is sought (COLMAP: 12 px and 4 px).
const RESECTION_SLACK: f64 = 3.0;
/// Photos a model grows by before all of it is adjusted again.
const GROWTH: f64 = 1.15;
/// Photos that move when one is added: itself and those that share most with it.
const NEIGHBOURS: usize = 6;
/// Photos of other models a model may take in, so that both can be joined.
const MAX_SHARED: usize = 10;
/// Times a photo is tried.
const TRIES: u32 = 3;
/// Starts tried before the largest model so far is taken.
const STARTS: usize = 3;
/// Factors tried on a guessed focal length whose camera has no photo in the model yet.
const FOCAL_FACTORS: [f64; 5] = [1.0, 0.7, 1.4, 0.5, 2.0];

/// The largest model that can be grown from photos not taken, `None` if no pair can start one.
pub(super) fn best(task: &Task<'_>, taken: &[bool]) -> Result<Option<Model>, MapError> {
    let mut best: Option<Model> = None;
    let mut grown = 0;
    for link in start::candidates(task, taken) {
        if best
            .as_ref()
            .is_some_and(|best| link.photos.iter().any(|&photo| best.poses[photo].is_some()))
        {
            continue;
        }
        let Some(model) = start::start(task, link)? else {
            continue;
        };
        let model = grow(task, model, taken)?;
        let size = |model: &Model| model.photos().filter(|&photo| !taken[photo]).count();
        if best.as_ref().is_none_or(|best| size(&model) > size(best)) {
            best = Some(model);
        }
        grown += 1;
        let reachable = reachable(task, link.photos[0], taken);
        let enough = best.as_ref().is_some_and(|best| 2 * size(best) >= reachable);
        if enough || grown >= STARTS {
            break;
        }
    }
    Ok(best.filter(|model| model.photos().count() >= MIN_PHOTOS.min(task.views.len())))
}

/// The number of photos not taken that chains of links lead to.
fn reachable(task: &Task<'_>, from: usize, taken: &[bool]) -> usize {
    let mut seen = vec![false; taken.len()];
    let mut open = vec![from];
    while let Some(photo) = open.pop() {
        if std::mem::replace(&mut seen[photo], true) {
            continue;
        }
        let links = task.links.iter().filter(|link| link.photos.contains(&photo));
        let others = links.map(|link| link.photos[0] + link.photos[1] - photo);
        open.extend(others.filter(|&other| !seen[other] && !taken[other]));
    }
    seen.iter().filter(|seen| **seen).count()
}

/// What is remembered of the photos that did not fit.
#[derive(Default)]
struct Attempts(BTreeMap<usize, (u32, usize)>);

impl Attempts {
    /// A photo may be tried again when it sees a tenth more points than the last time.
    fn allows(&self, photo: usize, visible: usize) -> bool {
        self.0
            .get(&photo)
            .is_none_or(|&(tries, last)| tries < TRIES && visible * 10 > last * 11)
    }

    fn note(&mut self, photo: usize, visible: usize) {
        let entry = self.0.entry(photo).or_default();
        *entry = (entry.0 + 1, visible);
    }
}

/// Adds photos one by one until none fits any more; when none does, all is adjusted and each gets another try.
pub(super) fn grow(task: &Task<'_>, mut model: Model, taken: &[bool]) -> Result<Model, MapError> {
    let mut attempts = Attempts::default();
    let mut adjusted = model.photos().count();
    let mut rested = 0;
    loop {
        if (task.stop)() {
            return Err(MapError::Stopped);
        }
        let placed = model.photos().count();
        let Some((photo, visible)) = next(task, &model, taken, &attempts) else {
            if placed == rested {
                return Ok(model);
            }
            settle(task, &mut model, &[], ROUGH)?;
            adjusted = model.photos().count();
            (rested, attempts) = (placed, Attempts::default());
            continue;
        };
        if !register(task, &mut model, photo)? {
            attempts.note(photo, visible);
            continue;
        }
        (task.placed)(placed + 1);
        if (placed + 1) as f64 >= GROWTH * adjusted as f64 {
            settle(task, &mut model, &[], ROUGH)?;
            adjusted = model.photos().count().max(placed);
        }
    }
}

/// The photo that sees most known points, best spread over it; of equals the first.
fn next(task: &Task<'_>, model: &Model, taken: &[bool], attempts: &Attempts) -> Option<(usize, usize)> {
    let shared = model.photos().filter(|&photo| taken[photo]).count();
    let open = |photo: &usize| model.poses[*photo].is_none() && !(taken[*photo] && shared >= MAX_SHARED);
    let candidates = (0..task.views.len()).filter(open).filter_map(|photo| {
        let visible = visible(task, model, photo);
        (visible.len() >= MIN_VISIBLE && attempts.allows(photo, visible.len()))
            .then(|| (spread(task, photo, &visible), photo, visible.len()))
    });
    let best = candidates.max_by_key(|&(score, photo, _)| (score, std::cmp::Reverse(photo)));
    best.map(|(_, photo, visible)| (photo, visible))
}

/// Sights of the photo whose track has a point.
fn visible(task: &Task<'_>, model: &Model, photo: usize) -> Vec<usize> {
    let known = |sight: &usize| model.points[task.tracks.sights[*sight].track as usize].is_some();
    task.tracks.in_photo(photo).filter(known).collect()
}

/// Occupied cells of grids of 2, 4 and 8 cells a side, each worth its grid's cells (Schönberger and Frahm 2016).
fn spread(task: &Task<'_>, photo: usize, sights: &[usize]) -> usize {
    let camera = &task.cameras[task.views[photo].camera].camera;
    let score = |level: u32| {
        let side = 1_usize << level;
        let cell =
            |position: f64, size: u32| ((position / f64::from(size) * side as f64) as usize).min(side - 1);
        let mut occupied = vec![false; side * side];
        for &sight in sights {
            let pixel = &task.tracks.sights[sight].pixel;
            occupied[cell(pixel.y, camera.height) * side + cell(pixel.x, camera.width)] = true;
        }
        side * side * occupied.iter().filter(|cell| **cell).count()
    };
    (1..=3).map(score).sum()
}

/// Places a photo and adjusts what lies around it; says whether it fits.
fn register(task: &Task<'_>, model: &mut Model, photo: usize) -> Result<bool, MapError> {
    let sights = visible(task, model, photo);
    let Some((resection, factor)) = pose_of(task, model, photo, &sights) else {
        return Ok(false);
    };
    let camera = &mut model.cameras[task.views[photo].camera];
    (camera.fx_px, camera.fy_px) = (camera.fx_px * factor, camera.fy_px * factor);
    model.poses[photo] = Some(resection.cam_from_world);
    for &inlier in &resection.inliers {
        model.active[inlier] = true;
    }
    model.complete(task, task.tracks.of_photos(&[photo]));
    let around = neighbours(task, model, photo);
    adjust_local(task, model, &around)?;
    model.filter(task, task.tracks.of_photos(&around));
    let held = model.active_in(task, photo).count();
    if held < MIN_INLIERS {
        model.remove(task, photo);
    }
    Ok(held >= MIN_INLIERS)
}

/// The pose most sights agree on, as indices of sights, and the factor on the focal length it was found with.
fn pose_of(task: &Task<'_>, model: &Model, photo: usize, sights: &[usize]) -> Option<(Resection, f64)> {
    let shared = &task.cameras[task.views[photo].camera];
    let first = model
        .photos()
        .all(|other| task.views[other].camera != task.views[photo].camera);
    let unknown = first && matches!(shared.focal, FocalKnown::Guessed);
    let factors = if unknown {
        &FOCAL_FACTORS[..]
    } else {
        &FOCAL_FACTORS[..1]
    };
    let tries = factors.iter().filter_map(|&factor| {
        let found = resection(task, model, photo, sights, factor)?;
        Some((found, factor))
    });
    let best = tries.fold(None, |best: Option<(Resection, f64)>, one| match best {
        Some(best) if best.0.inliers.len() >= one.0.inliers.len() => Some(best),
        _ => Some(one),
    });
    let enough = MIN_INLIERS.max((MIN_INLIER_SHARE * sights.len() as f64) as usize);
    best.filter(|(found, _)| found.inliers.len() >= enough)
}

fn resection(
    task: &Task<'_>,
    model: &Model,
    photo: usize,
    sights: &[usize],
    factor: f64,
) -> Option<Resection> {
    let mut camera = model.cameras[task.views[photo].camera];
    (camera.fx_px, camera.fy_px) = (camera.fx_px * factor, camera.fy_px * factor);
    let (mut tried, mut seen) = (Vec::new(), Vec::new());
    for &sight in sights {
        let one = &task.tracks.sights[sight];
        if let (Some(world), Some(ray)) = (model.points[one.track as usize], camera.unproject(&one.pixel)) {
            tried.push(sight);
            seen.push(Seen {
                plane: ray.xy(),
                world,
            });
        }
    }
    let max_error = RESECTION_SLACK * task.options.max_error_px / camera.fx_px;
    let mut found = resect(&seen, max_error, task.options.seed ^ photo as u64)?;
    found
        .inliers
        .iter_mut()
        .for_each(|inlier| *inlier = tried[*inlier]);
    Some(found)
}

/// The photo, and those that share most points with it; of equals the first.
fn neighbours(task: &Task<'_>, model: &Model, photo: usize) -> Vec<usize> {
    let mut shared = vec![0_usize; task.views.len()];
    for sight in model.active_in(task, photo) {
        let track = task.tracks.sights[sight].track as usize;
        let active = task.tracks.range(track).filter(|&other| model.active[other]);
        active.for_each(|other| shared[task.tracks.sights[other].photo as usize] += 1);
    }
    shared[photo] = 0;
    let mut others: Vec<usize> = (0..shared.len()).filter(|&other| shared[other] > 0).collect();
    others.sort_by_key(|&other| (std::cmp::Reverse(shared[other]), other));
    others.truncate(NEIGHBOURS);
    others.push(photo);
    others.sort_unstable();
    others
}
