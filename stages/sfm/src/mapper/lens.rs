//! Choice of distortion model and principal point.

use marf_scene::{Camera, Pose};
use nalgebra::Vector3;

use super::global_adjustment::{COMPARISON, FINE, adjust_all, refine};
use super::input::{MapError, MapperInput};
use super::model::Model;
use super::options::{LensChoice, PrincipalPointChoice};
use crate::bundle::{LensModel, information_criterion};

/// Smallest number of photos, and smallest angle between their optical axes, that distinguish a shifted principal
/// point from rotated cameras. An orbit does, a descent or a row of parallel views does not.
const PRINCIPAL_POINT_PHOTOS: usize = 20;
const PRINCIPAL_POINT_SPAN_RAD: f64 = 0.6;

/// Chooses distortion model and principal point of a model, and adjusts it a last time.
pub(super) fn choose_lens(input: &MapperInput<'_>, model: &mut Model) -> Result<(), MapError> {
    let mut best = smallest(input, model)?;
    let choice = input.options.principal_point;
    if choice == PrincipalPointChoice::Free
        || (choice == PrincipalPointChoice::Supported && views_span_angle(model))
    {
        best = with_principal_point(input, best)?;
    }
    *model = best.model;
    refine(input, model, &[], FINE)
}

/// A model adjusted with one choice of lens, and its information criterion.
struct Trial {
    score: f64,
    model: Model,
}

/// Returns a model adjusted with a distortion model.
fn tried(input: &MapperInput<'_>, model: &Model, lens: LensModel) -> Result<Trial, MapError> {
    let mut model = model.clone();
    model.lens = lens;
    for camera in &mut model.cameras {
        *camera = restricted(camera, lens);
    }
    let report = adjust_all(input, &mut model, &[], COMPARISON)?;
    let score = information_criterion(&report);
    Ok(Trial { score, model })
}

/// Whether there are enough photos and their optical axes span an angle.
fn views_span_angle(model: &Model) -> bool {
    let axis = |pose: &Pose| pose.rotation.transpose() * Vector3::z();
    let axes: Vec<Vector3<f64>> = model.poses.iter().flatten().map(axis).collect();
    let cosine = libm::cos(PRINCIPAL_POINT_SPAN_RAD);
    axes.len() >= PRINCIPAL_POINT_PHOTOS && axes.iter().any(|other| other.dot(&axes[0]) < cosine)
}

/// Returns the radial model with the fewest coefficients that the photos support, from two to none: if fewer are worse,
/// still fewer are not tried.
fn smallest(input: &MapperInput<'_>, model: &Model) -> Result<Trial, MapError> {
    if let LensChoice::Fixed(lens) = input.options.lens {
        return tried(input, model, lens);
    }
    let mut best = tried(input, model, LensModel::Radial)?;
    for lens in [LensModel::SimpleRadial, LensModel::Pinhole] {
        let fewer = tried(input, &best.model, lens)?;
        // Equal: too few photos to free the coefficients, which are zero then.
        if fewer.score > best.score {
            break;
        }
        best = fewer;
    }
    Ok(best)
}

/// Returns the model with a free principal point, and then with tangential distortion, if the photos support them. On
/// request, the principal point is free in any case.
///
/// Tangential distortion is tried second because with a fixed principal point it replaces the shift of that point,
/// and badly. On the mock-up it lowers the error by 2 % and rotates the cameras twice as far from COLMAP's.
fn with_principal_point(input: &MapperInput<'_>, held: Trial) -> Result<Trial, MapError> {
    let mut free = held.model.clone();
    free.principal_point = true;
    let free = tried(input, &free, held.model.lens)?;
    if input.options.principal_point == PrincipalPointChoice::Supported && free.score >= held.score {
        return Ok(held);
    }
    if matches!(input.options.lens, LensChoice::Fixed(_)) {
        return Ok(free);
    }
    let tangential = tried(input, &free.model, LensModel::OpenCv)?;
    Ok(if tangential.score < free.score {
        tangential
    } else {
        free
    })
}

/// Returns the camera without the coefficients that a distortion model does not have.
fn restricted(camera: &Camera, lens: LensModel) -> Camera {
    let keep = |least: LensModel, term: f64| if lens >= least { term } else { 0.0 };
    Camera {
        k1: keep(LensModel::SimpleRadial, camera.k1),
        k2: keep(LensModel::Radial, camera.k2),
        p1: keep(LensModel::OpenCv, camera.p1),
        p2: keep(LensModel::OpenCv, camera.p2),
        ..*camera
    }
}
