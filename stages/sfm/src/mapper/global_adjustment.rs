//! Bundle adjustment of a model, local and global.

use nalgebra::{Matrix6, Vector3};

use super::input::{MapError, MapperInput};
use super::model::Model;
use crate::bundle::{
    self, BundleOptions, BundleReport, CameraFreedom, LensModel, Loss, PoseFreedom, Prior, Problem, Solver,
    adjust, own_pose_covariances, pose_covariances,
};
use crate::view_graph::SharedCamera;

/// Photos of one camera from which its focal length is free. With fewer it is fixed.
const PHOTOS_FOR_FOCAL: usize = 3;
/// Photos of the model from which a guessed focal length (or EXIF's whole millimetres) is free in any case: their
/// points determine it.
const PHOTOS_FOR_ANY_FOCAL: usize = 6;
const VAGUE_SIGMA: f64 = 0.05;
/// Photos of one camera from which k1 is free.
const PHOTOS_FOR_K1: usize = 3;
/// Photos of one camera from which all camera parameters are free.
const PHOTOS_FOR_LENS: usize = 8;
/// Smallest number of observations of a registered photo.
const MIN_OBSERVATIONS: usize = 12;
/// Share of the observations that may still change when a model has converged (COLMAP).
const CONVERGED_SHARE: f64 = 5e-4;

/// Number of rounds and steps of a refinement, and its tolerance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RefinementEffort {
    /// Largest number of rounds of adjustment and filtering.
    pub rounds: u32,
    /// Largest number of steps of an adjustment.
    pub iterations: u32,
    /// Relative change of the cost at which an adjustment ends.
    pub tolerance: f64,
}

/// While photos are registered: later photos change the model anyway.
pub(crate) const COARSE: RefinementEffort = RefinementEffort {
    rounds: 1,
    iterations: 8,
    tolerance: 1e-3,
};
/// To compare two distortion models.
pub(crate) const COMPARISON: RefinementEffort = RefinementEffort {
    rounds: 1,
    iterations: 12,
    tolerance: 1e-5,
};
/// For the result.
pub(crate) const FINE: RefinementEffort = RefinementEffort {
    rounds: 4,
    iterations: 25,
    tolerance: 1e-6,
};

/// Which poses are free.
pub(super) enum Scope<'a> {
    /// All, and the cameras.
    All,
    /// Only these. The other photos that observe their points are fixed, and so are the cameras.
    Only(&'a [usize]),
}

/// Adjusts all poses, points and cameras. Priors name poses by their rank among the model's photos.
pub(crate) fn adjust_all(
    input: &MapperInput<'_>,
    model: &mut Model,
    priors: &[Prior],
    effort: RefinementEffort,
) -> Result<BundleReport, MapError> {
    adjust_scope(input, model, &Scope::All, priors, effort)
}

/// Adjusts some photos and their points.
pub(super) fn adjust_local(
    input: &MapperInput<'_>,
    model: &mut Model,
    photos: &[usize],
) -> Result<(), MapError> {
    adjust_scope(input, model, &Scope::Only(photos), &[], COARSE).map(|_| ())
}

/// Adjusts, completes and filters tracks until hardly any observation changes, then removes weak photos.
pub(crate) fn refine(
    input: &MapperInput<'_>,
    model: &mut Model,
    priors: &[Prior],
    effort: RefinementEffort,
) -> Result<(), MapError> {
    for _ in 0..effort.rounds {
        adjust_all(input, model, priors, effort)?;
        let before = model.active.clone();
        model.complete(input, input.tracks.all());
        model.filter(input, input.tracks.all());
        let changed = before.iter().zip(&model.active).filter(|(old, new)| old != new);
        if (changed.count() as f64) < CONVERGED_SHARE * model.active_count() as f64 {
            break;
        }
    }
    remove_weak_photos(input, model);
    Ok(())
}

/// Standard deviations of the pose of a photo, relative to the first photo of the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseUncertainty {
    /// Of the attitude: the root of the summed variances about three axes.
    pub angle_rad: f64,
    /// Of the centre, likewise, in the unit of the model.
    pub distance: f64,
}

/// Returns the uncertainty of each registered photo, in order. `None` if it is not determined.
///
/// The covariance of the reduced system times the variance of one coordinate.
///
/// # Errors
/// [`MapError::Stopped`].
pub fn pose_uncertainties(
    input: &MapperInput<'_>,
    model: &Model,
) -> Result<Option<Vec<PoseUncertainty>>, MapError> {
    let mut built = build(input, model, &input.tracks.all());
    built.problem.camera_freedom = freedoms(input, model);
    built.problem.priors = focal_priors(input, model);
    fix_gauge(model, &mut built);
    let covariances = pose_covariances(&built.problem, sigma_px(input, model), input.stop);
    input.check_stop()?;
    let of = |covariance: &Matrix6<f64>| {
        let root = |first: usize| {
            (first..first + 3)
                .map(|axis| covariance[(axis, axis)])
                .sum::<f64>()
                .sqrt()
        };
        PoseUncertainty {
            angle_rad: root(0),
            distance: root(3),
        }
    };
    Ok(covariances.map(|covariances| covariances.iter().map(of).collect()))
}

/// Returns the covariance of each registered photo from its own observations alone, in order: points and other photos
/// are held. `None` for a photo that they do not determine.
pub(crate) fn own_covariances(input: &MapperInput<'_>, model: &Model) -> Vec<Option<Matrix6<f64>>> {
    let built = build(input, model, &input.tracks.all());
    own_pose_covariances(&built.problem, sigma_px(input, model))
}

/// Returns the standard deviation of one coordinate of an observation: the mean reprojection error is sigma
/// sqrt(pi / 2).
fn sigma_px(input: &MapperInput<'_>, model: &Model) -> f64 {
    let active = (0..model.active.len()).filter(|&observation| model.active[observation]);
    let errors: Vec<f64> = active
        .filter_map(|observation| model.error_px(input, &input.tracks.observations[observation]))
        .collect();
    let mean_px = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    mean_px / std::f64::consts::FRAC_PI_2.sqrt()
}

/// Removes photos with too few observations.
fn remove_weak_photos(input: &MapperInput<'_>, model: &mut Model) {
    let photos: Vec<usize> = model.photos().collect();
    for photo in photos {
        if model.active_in(input, photo).count() < MIN_OBSERVATIONS {
            model.remove(input, photo);
        }
    }
    model.move_anchor();
}

/// Adjusts the poses of a scope.
fn adjust_scope(
    input: &MapperInput<'_>,
    model: &mut Model,
    scope: &Scope<'_>,
    priors: &[Prior],
    effort: RefinementEffort,
) -> Result<BundleReport, MapError> {
    let tracks = match scope {
        Scope::All => input.tracks.all(),
        Scope::Only(photos) => input.tracks.of_photos(photos),
    };
    let mut built = build(input, model, &tracks);
    match scope {
        Scope::All => {
            built.problem.camera_freedom = freedoms(input, model);
            built.problem.priors = [focal_priors(input, model), priors.to_vec()].concat();
            if priors.is_empty() {
                fix_gauge(model, &mut built);
            }
        }
        Scope::Only(photos) => fix_others(model, photos, &mut built),
    }
    let loss = match scope {
        Scope::All => Loss::Cauchy(input.options.max_error_px / 4.0),
        Scope::Only(_) => Loss::Huber(input.options.max_error_px / 4.0),
    };
    let options = BundleOptions {
        loss,
        prior_loss: Loss::Cauchy(2.0),
        max_iterations: effort.iterations,
        tolerance: effort.tolerance,
        solver: Solver::Auto,
    };
    let report = adjust(&mut built.problem, &options, input.stop)?;
    input.check_stop()?;
    write_back(model, &built);
    Ok(report)
}

/// A bundle adjustment problem with the photos and tracks of its indices.
struct IndexedProblem {
    problem: Problem,
    photos: Vec<usize>,
    tracks: Vec<usize>,
}

/// Returns the problem of some tracks. It has every registered photo, so that priors can name it by its rank.
fn build(input: &MapperInput<'_>, model: &Model, tracks: &[usize]) -> IndexedProblem {
    let photos: Vec<usize> = model.photos().collect();
    let mut rank = vec![u32::MAX; model.poses.len()];
    for (index, &photo) in photos.iter().enumerate() {
        rank[photo] = index as u32;
    }
    let mut problem = Problem {
        cameras: model.cameras.clone(),
        camera_freedom: vec![FIXED; model.cameras.len()],
        poses: photos.iter().filter_map(|&photo| model.poses[photo]).collect(),
        pose_freedom: vec![PoseFreedom::Free; photos.len()],
        camera_of_pose: photos
            .iter()
            .map(|&photo| input.views[photo].camera as u32)
            .collect(),
        ..Problem::default()
    };
    let mut kept = Vec::new();
    for &track in tracks {
        let Some(point) = model.points[track] else {
            continue;
        };
        for observation in input
            .tracks
            .range(track)
            .filter(|&observation| model.active[observation])
        {
            let one = &input.tracks.observations[observation];
            problem.observations.push(bundle::Observation {
                point: kept.len() as u32,
                pose: rank[one.photo as usize],
                pixel: one.pixel,
            });
        }
        kept.push(track);
        problem.points.push(point);
    }
    IndexedProblem {
        problem,
        photos,
        tracks: kept,
    }
}

/// Writes an adjusted problem back to its model.
fn write_back(model: &mut Model, built: &IndexedProblem) {
    model.cameras.clone_from(&built.problem.cameras);
    for (&photo, pose) in built.photos.iter().zip(&built.problem.poses) {
        model.poses[photo] = Some(*pose);
    }
    for (&track, point) in built.tracks.iter().zip(&built.problem.points) {
        model.points[track] = Some(*point);
    }
}

/// A camera without free parameters.
const FIXED: CameraFreedom = CameraFreedom {
    focal: false,
    lens: LensModel::Pinhole,
    principal_point: false,
};

/// Returns the free parameters of each camera. More are free as photos are registered, so that a weak start does not
/// diverge.
fn freedoms(input: &MapperInput<'_>, model: &Model) -> Vec<CameraFreedom> {
    let mut counts = vec![0; model.cameras.len()];
    for photo in model.photos() {
        counts[input.views[photo].camera] += 1;
    }
    let placed = model.photos().count();
    let freedom = |(&count, shared): (&usize, &SharedCamera)| {
        let vague = shared.focal_sigma_share.is_none_or(|sigma| sigma > VAGUE_SIGMA);
        CameraFreedom {
            focal: count >= PHOTOS_FOR_FOCAL || (vague && count > 0 && placed >= PHOTOS_FOR_ANY_FOCAL),
            lens: released(model.lens, count),
            principal_point: model.principal_point && count >= PHOTOS_FOR_LENS,
        }
    };
    counts.iter().zip(input.cameras).map(freedom).collect()
}

/// Returns the part of a distortion model that is free with a number of photos.
fn released(lens: LensModel, photos: usize) -> LensModel {
    match photos {
        0..PHOTOS_FOR_K1 => LensModel::Pinhole,
        PHOTOS_FOR_K1..PHOTOS_FOR_LENS => lens.min(LensModel::SimpleRadial),
        _ => lens,
    }
}

/// Returns priors on the known focal lengths.
fn focal_priors(input: &MapperInput<'_>, model: &Model) -> Vec<Prior> {
    let known = input.cameras.iter().enumerate().take(model.cameras.len());
    let priors = known.filter_map(|(index, shared)| {
        Some(Prior::Focal {
            camera: index as u32,
            focal_px: shared.camera.fx_px,
            sigma_share: shared.focal_sigma_share?,
        })
    });
    priors.collect()
}

/// Fixes the gauge: the pose of the anchor and, of the photo farthest from it, the coordinate in which it is farthest.
fn fix_gauge(model: &Model, built: &mut IndexedProblem) {
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

/// Returns the axis of the largest coordinate, the first on ties.
fn widest_axis(offset: &Vector3<f64>) -> u8 {
    let axes = [0_u8, 1, 2];
    let wider = |a: &u8, b: &u8| {
        let size = |axis: u8| offset[usize::from(axis)].abs();
        size(*a).total_cmp(&size(*b)).then(b.cmp(a))
    };
    axes.into_iter().max_by(wider).unwrap_or(0)
}

/// Fixes all but the given photos. If that fixes none, the gauge is fixed instead.
fn fix_others(model: &Model, photos: &[usize], built: &mut IndexedProblem) {
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
        fix_gauge(model, built);
    }
}
