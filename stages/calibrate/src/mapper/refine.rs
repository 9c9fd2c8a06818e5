use nalgebra::{Matrix6, Vector3};

use super::{MapError, Model, Task};
use crate::bundle::{
    BundleOptions, BundleReport, CameraFreedom, LensModel, Loss, Observation, PoseFreedom, Prior, Problem,
    Solver, adjust, pose_covariances,
};

/// Photos of one camera from which its focal length is refined; with fewer it is taken as it is,
const PHOTOS_FOR_FOCAL: usize = 3;
/// unless it is a guess (or EXIF's whole millimetres), and the model has this many photos: their points hold it.
const PHOTOS_FOR_ANY_FOCAL: usize = 6;
const VAGUE_SIGMA: f64 = 0.05;
/// Photos of one camera from which k1 is refined.
const PHOTOS_FOR_K1: usize = 3;
/// Photos of one camera from which all lens terms are refined.
const PHOTOS_FOR_LENS: usize = 8;
/// Fewest sights that hold a photo in a model.
const MIN_SIGHTS: usize = 12;
/// Share of the sights that may still change when a model counts as settled (COLMAP).
const SETTLED_SHARE: f64 = 5e-4;

/// How near to the minimum an adjustment goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Effort {
    pub rounds: u32,
    pub iterations: u32,
    /// Relative change of the cost that ends it.
    pub tolerance: f64,
}

/// While a model grows: what comes next moves it anyway.
pub(crate) const ROUGH: Effort = Effort {
    rounds: 1,
    iterations: 8,
    tolerance: 1e-3,
};
/// To tell which of two lenses is better.
pub(crate) const JUDGED: Effort = Effort {
    rounds: 1,
    iterations: 12,
    tolerance: 1e-5,
};
/// For what is kept.
pub(crate) const FINE: Effort = Effort {
    rounds: 4,
    iterations: 25,
    tolerance: 1e-6,
};

/// Which photos move.
pub(super) enum Scope<'a> {
    /// All, and the cameras with them.
    All,
    /// These; the others that see their points are held, and so are the cameras.
    Only(&'a [usize]),
}

/// Adjusts what the scope says, with priors of the caller in the order of the model's photos.
pub(crate) fn adjust_all(
    task: &Task<'_>,
    model: &mut Model,
    priors: &[Prior],
    effort: Effort,
) -> Result<BundleReport, MapError> {
    adjust_scope(task, model, &Scope::All, priors, effort)
}

pub(super) fn adjust_local(task: &Task<'_>, model: &mut Model, photos: &[usize]) -> Result<(), MapError> {
    adjust_scope(task, model, &Scope::Only(photos), &[], ROUGH).map(|_| ())
}

/// Adjusts, completes and filters until hardly a sight changes.
pub(crate) fn settle(
    task: &Task<'_>,
    model: &mut Model,
    priors: &[Prior],
    effort: Effort,
) -> Result<(), MapError> {
    for _ in 0..effort.rounds {
        adjust_all(task, model, priors, effort)?;
        let before = model.active.clone();
        model.complete(task, task.tracks.all());
        model.filter(task, task.tracks.all());
        let changed = before.iter().zip(&model.active).filter(|(old, new)| old != new);
        if (changed.count() as f64) < SETTLED_SHARE * model.active_count() as f64 {
            break;
        }
    }
    drop_weak(task, model);
    Ok(())
}

/// Standard deviations of a placed photo, relative to the photo the model began with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Deviation {
    /// Of the attitude, the root of the summed variances about three axes.
    pub angle_rad: f64,
    /// Of the centre, likewise, in the model's unit.
    pub distance: f64,
}

/// What the reprojection errors leave open of each placed photo, in order; `None` where they do not tell.
///
/// The covariance of the reduced system times the variance of one coordinate: the mean distance of a sight from
/// its point's image is sigma sqrt(pi / 2).
pub(crate) fn deviations(task: &Task<'_>, model: &Model) -> Option<Vec<Deviation>> {
    let mut built = build(task, model, &task.tracks.all());
    built.problem.camera_freedom = freedoms(task, model);
    built.problem.priors = focal_priors(task, model);
    hold_gauge(model, &mut built);
    let active = (0..model.active.len()).filter(|&sight| model.active[sight]);
    let errors: Vec<f64> = active
        .filter_map(|sight| model.error_px(task, &task.tracks.sights[sight]))
        .collect();
    let mean_px = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    let sigma_px = mean_px / std::f64::consts::FRAC_PI_2.sqrt();
    let covariances = pose_covariances(&built.problem, sigma_px)?;
    let of = |covariance: &Matrix6<f64>| {
        let root = |first: usize| {
            (first..first + 3)
                .map(|axis| covariance[(axis, axis)])
                .sum::<f64>()
                .sqrt()
        };
        Deviation {
            angle_rad: root(0),
            distance: root(3),
        }
    };
    Some(covariances.iter().map(of).collect())
}

/// Takes out photos that too few sights hold.
fn drop_weak(task: &Task<'_>, model: &mut Model) {
    let photos: Vec<usize> = model.photos().collect();
    for photo in photos {
        if model.active_in(task, photo).count() < MIN_SIGHTS {
            model.remove(task, photo);
        }
    }
    if model.poses[model.anchor].is_none() {
        let next = model.photos().next();
        model.anchor = next.unwrap_or(model.anchor);
    }
}

fn adjust_scope(
    task: &Task<'_>,
    model: &mut Model,
    scope: &Scope<'_>,
    priors: &[Prior],
    effort: Effort,
) -> Result<BundleReport, MapError> {
    let tracks = match scope {
        Scope::All => task.tracks.all(),
        Scope::Only(photos) => task.tracks.of_photos(photos),
    };
    let mut built = build(task, model, &tracks);
    match scope {
        Scope::All => {
            built.problem.camera_freedom = freedoms(task, model);
            built.problem.priors = [focal_priors(task, model), priors.to_vec()].concat();
            if priors.is_empty() {
                hold_gauge(model, &mut built);
            }
        }
        Scope::Only(photos) => hold_others(model, photos, &mut built),
    }
    let loss = match scope {
        Scope::All => Loss::Cauchy(task.options.max_error_px / 4.0),
        Scope::Only(_) => Loss::Huber(task.options.max_error_px / 4.0),
    };
    let options = BundleOptions {
        loss,
        prior_loss: Loss::Cauchy(2.0),
        max_iterations: effort.iterations,
        tolerance: effort.tolerance,
        solver: Solver::Auto,
    };
    let report = adjust(&mut built.problem, &options, task.stop)?;
    if (task.stop)() {
        return Err(MapError::Stopped);
    }
    write_back(model, &built);
    Ok(report)
}

/// A problem, and what its indices stand for.
struct Built {
    problem: Problem,
    photos: Vec<usize>,
    tracks: Vec<usize>,
}

/// Collects the points of the tracks and all that see them; every placed photo keeps a place, so that priors
/// can name it by its rank.
fn build(task: &Task<'_>, model: &Model, tracks: &[usize]) -> Built {
    let photos: Vec<usize> = model.photos().collect();
    let mut rank = vec![u32::MAX; model.poses.len()];
    for (index, &photo) in photos.iter().enumerate() {
        rank[photo] = index as u32;
    }
    let mut problem = Problem {
        cameras: model.cameras.clone(),
        camera_freedom: vec![HELD; model.cameras.len()],
        poses: photos.iter().filter_map(|&photo| model.poses[photo]).collect(),
        pose_freedom: vec![PoseFreedom::Free; photos.len()],
        camera_of_pose: photos
            .iter()
            .map(|&photo| task.views[photo].camera as u32)
            .collect(),
        ..Problem::default()
    };
    let mut kept = Vec::new();
    for &track in tracks {
        let Some(point) = model.points[track] else {
            continue;
        };
        for sight in task.tracks.range(track).filter(|&sight| model.active[sight]) {
            let seen = &task.tracks.sights[sight];
            problem.observations.push(Observation {
                point: kept.len() as u32,
                pose: rank[seen.photo as usize],
                pixel: seen.pixel,
            });
        }
        kept.push(track);
        problem.points.push(point);
    }
    Built {
        problem,
        photos,
        tracks: kept,
    }
}

fn write_back(model: &mut Model, built: &Built) {
    model.cameras.clone_from(&built.problem.cameras);
    for (&photo, pose) in built.photos.iter().zip(&built.problem.poses) {
        model.poses[photo] = Some(*pose);
    }
    for (&track, point) in built.tracks.iter().zip(&built.problem.points) {
        model.points[track] = Some(*point);
    }
}

/// A camera that does not move.
const HELD: CameraFreedom = CameraFreedom {
    focal: false,
    lens: LensModel::Pinhole,
    principal_point: false,
};

/// What may move of each camera: a weak start must not run off, so terms are released as photos come in.
fn freedoms(task: &Task<'_>, model: &Model) -> Vec<CameraFreedom> {
    let mut counts = vec![0; model.cameras.len()];
    for photo in model.photos() {
        counts[task.views[photo].camera] += 1;
    }
    let placed = model.photos().count();
    let freedom = |(&count, shared): (&usize, &super::SharedCamera)| {
        let vague = shared.focal_sigma_share.is_none_or(|sigma| sigma > VAGUE_SIGMA);
        CameraFreedom {
            focal: count >= PHOTOS_FOR_FOCAL || (vague && count > 0 && placed >= PHOTOS_FOR_ANY_FOCAL),
            lens: released(model.lens, count),
            principal_point: model.principal_point && count >= PHOTOS_FOR_LENS,
        }
    };
    counts.iter().zip(task.cameras).map(freedom).collect()
}

fn released(lens: LensModel, photos: usize) -> LensModel {
    match photos {
        0..PHOTOS_FOR_K1 => LensModel::Pinhole,
        PHOTOS_FOR_K1..PHOTOS_FOR_LENS => lens.min(LensModel::SimpleRadial),
        _ => lens,
    }
}

fn focal_priors(task: &Task<'_>, model: &Model) -> Vec<Prior> {
    let known = task.cameras.iter().enumerate().take(model.cameras.len());
    let prior = |(index, shared): (usize, &super::SharedCamera)| {
        shared.focal_sigma_share.map(|sigma_share| Prior::Focal {
            camera: index as u32,
            focal_px: shared.camera.fx_px,
            sigma_share,
        })
    };
    known.filter_map(prior).collect()
}

/// Holds the anchor and, of the photo farthest from it, the coordinate in which it is farthest.
fn hold_gauge(model: &Model, built: &mut Built) {
    let Some(anchor) = built.photos.iter().position(|&photo| photo == model.anchor) else {
        return;
    };
    let centre = built.problem.poses[anchor].centre();
    let offsets = built.problem.poses.iter().map(|pose| pose.centre() - centre);
    let far = offsets
        .enumerate()
        .max_by(|a, b| a.1.norm().total_cmp(&b.1.norm()).then(b.0.cmp(&a.0)));
    built.problem.pose_freedom[anchor] = PoseFreedom::Fixed;
    if let Some((index, offset)) = far.filter(|(index, _)| *index != anchor) {
        built.problem.pose_freedom[index] = PoseFreedom::CentreAxisFixed(widest_axis(&offset));
    }
}

fn widest_axis(offset: &Vector3<f64>) -> u8 {
    let axes = [0_u8, 1, 2];
    let wider = |a: &u8, b: &u8| {
        let size = |axis: u8| offset[usize::from(axis)].abs();
        size(*a).total_cmp(&size(*b)).then(b.cmp(a))
    };
    axes.into_iter().max_by(wider).unwrap_or(0)
}

/// Holds all but the given photos; if that holds nobody, the gauge is held instead.
fn hold_others(model: &Model, photos: &[usize], built: &mut Built) {
    for (photo, freedom) in built.photos.iter().zip(&mut built.problem.pose_freedom) {
        if !photos.contains(photo) {
            *freedom = PoseFreedom::Fixed;
        }
    }
    if built
        .problem
        .pose_freedom
        .iter()
        .all(|freedom| *freedom == PoseFreedom::Free)
    {
        hold_gauge(model, built);
    }
}
