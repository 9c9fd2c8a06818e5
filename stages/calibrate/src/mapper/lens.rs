use marf_scene::{Camera, Pose};
use nalgebra::Vector3;

use super::refine::{FINE, JUDGED, adjust_all, settle};
use super::{MapError, Model, Task};
use crate::bundle::{LensModel, information_criterion};

/// Which lens terms a scene gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LensChoice {
    /// The smallest model the data support; while a scene grows, this one.
    Smallest {
        growing: LensModel,
    },
    Fixed(LensModel),
}

/// Whether the principal point moves, as the last step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CentreChoice {
    Held,
    Free,
    /// Where the photos determine it and the information criterion asks for it.
    Supported,
}

/// Photos a scene needs, and the angle its views must span, to tell a shifted principal point from turned
/// cameras: a walk around does, a descent or a row of parallel views does not.
const CENTRE_PHOTOS: usize = 20;
const CENTRE_SPAN_RAD: f64 = 0.6;

impl LensChoice {
    pub(super) fn while_growing(self) -> LensModel {
        match self {
            Self::Smallest { growing } => growing,
            Self::Fixed(lens) => lens,
        }
    }
}

/// Chooses lens terms and principal point, and adjusts a last time.
pub(super) fn finish(task: &Task<'_>, model: &mut Model) -> Result<(), MapError> {
    let mut best = smallest(task, model)?;
    let centre = task.options.centre;
    if centre == CentreChoice::Free || (centre == CentreChoice::Supported && turns(model)) {
        best = with_centre(task, best)?;
    }
    *model = best.model;
    settle(task, model, &[], FINE)
}

/// A model adjusted with some choice of lens, and its information criterion.
struct Trial {
    score: f64,
    model: Model,
}

fn tried(task: &Task<'_>, model: &Model, lens: LensModel) -> Result<Trial, MapError> {
    let mut model = model.clone();
    model.lens = lens;
    for camera in &mut model.cameras {
        *camera = cut(camera, lens);
    }
    let report = adjust_all(task, &mut model, &[], JUDGED)?;
    let score = information_criterion(&report);
    Ok(Trial { score, model })
}

/// Tells whether the views are many and span an angle.
fn turns(model: &Model) -> bool {
    let axis = |pose: &Pose| pose.rotation.transpose() * Vector3::z();
    let axes: Vec<Vector3<f64>> = model.poses.iter().flatten().map(axis).collect();
    let cosine = libm::cos(CENTRE_SPAN_RAD);
    axes.len() >= CENTRE_PHOTOS && axes.iter().any(|other| other.dot(&axes[0]) < cosine)
}

/// The radial lens with fewest terms that the data support, from two to none: when fewer make it worse, still
/// fewer are not tried.
fn smallest(task: &Task<'_>, model: &Model) -> Result<Trial, MapError> {
    if let LensChoice::Fixed(lens) = task.options.lens {
        return tried(task, model, lens);
    }
    let mut best = tried(task, model, LensModel::Radial)?;
    for lens in [LensModel::SimpleRadial, LensModel::Pinhole] {
        let fewer = tried(task, &best.model, lens)?;
        // Equal: too few photos to release the terms, which are zero then.
        if fewer.score > best.score {
            break;
        }
        best = fewer;
    }
    Ok(best)
}

/// The same with a free principal point, and then with tangential terms, where the data support them; asked for,
/// the principal point is free in any case.
///
/// With a held principal point tangential terms stand in for its shift, and badly (mock-up: they lower the error
/// by 2 %, and turn the cameras twice as far from COLMAP's): they are tried after it.
fn with_centre(task: &Task<'_>, held: Trial) -> Result<Trial, MapError> {
    let mut free = held.model.clone();
    free.principal_point = true;
    let free = tried(task, &free, held.model.lens)?;
    if task.options.centre == CentreChoice::Supported && free.score >= held.score {
        return Ok(held);
    }
    if matches!(task.options.lens, LensChoice::Fixed(_)) {
        return Ok(free);
    }
    let tangential = tried(task, &free.model, LensModel::OpenCv)?;
    Ok(if tangential.score < free.score {
        tangential
    } else {
        free
    })
}

/// The camera without the terms the lens model does not have.
fn cut(camera: &Camera, lens: LensModel) -> Camera {
    let keep = |least: LensModel, term: f64| if lens >= least { term } else { 0.0 };
    Camera {
        k1: keep(LensModel::SimpleRadial, camera.k1),
        k2: keep(LensModel::Radial, camera.k2),
        p1: keep(LensModel::OpenCv, camera.p1),
        p2: keep(LensModel::OpenCv, camera.p2),
        ..*camera
    }
}
