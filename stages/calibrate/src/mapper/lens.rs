use marf_scene::{Camera, Pose};
use nalgebra::Vector3;

use super::refine::{FINE, adjust_all, settle};
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
    let free_centre = match task.options.centre {
        CentreChoice::Held => vec![false],
        CentreChoice::Free => vec![true],
        CentreChoice::Supported if turns(model) => vec![false, true],
        CentreChoice::Supported => vec![false],
    };
    let mut best: Option<(f64, Model)> = None;
    for principal_point in free_centre {
        let (score, trial) = smallest(
            task,
            &Model {
                principal_point,
                ..model.clone()
            },
        )?;
        if best.as_ref().is_none_or(|(lowest, _)| score < *lowest) {
            best = Some((score, trial));
        }
    }
    if let Some((_, chosen)) = best {
        *model = chosen;
    }
    settle(task, model, &[], FINE)
}

/// Tells whether the views are many and span an angle.
fn turns(model: &Model) -> bool {
    let axis = |pose: &Pose| pose.rotation.transpose() * Vector3::z();
    let axes: Vec<Vector3<f64>> = model.poses.iter().flatten().map(axis).collect();
    let cosine = libm::cos(CENTRE_SPAN_RAD);
    axes.len() >= CENTRE_PHOTOS && axes.iter().any(|other| other.dot(&axes[0]) < cosine)
}

/// The adjusted model with the lens whose information criterion is lowest, from many terms to few; when fewer
/// than two make it worse, still fewer are not tried.
///
/// Tangential terms are tried only where the principal point is free: with a held one they stand in for its
/// shift, and badly (mock-up: they lower the error by 2 %, and put the cameras twice as far from COLMAP's).
fn smallest(task: &Task<'_>, model: &Model) -> Result<(f64, Model), MapError> {
    let lenses: &[LensModel] = match task.options.lens {
        LensChoice::Fixed(ref lens) => std::slice::from_ref(lens),
        LensChoice::Smallest { .. } if model.principal_point => &LENSES,
        LensChoice::Smallest { .. } => &LENSES[1..],
    };
    let mut best: Option<(f64, Model)> = None;
    for &lens in lenses {
        let mut trial = model.clone();
        trial.lens = lens;
        trial.cameras = model.cameras.iter().map(|camera| cut(camera, lens)).collect();
        let report = adjust_all(task, &mut trial, &[], FINE)?;
        let score = information_criterion(&report);
        if best.as_ref().is_some_and(|(lowest, _)| score > *lowest) && lens < LensModel::Radial {
            break;
        }
        // Equal: too few photos to release the terms, which are zero then.
        if best.as_ref().is_none_or(|(lowest, _)| score <= *lowest) {
            best = Some((score, trial));
        }
    }
    Ok(best.unwrap_or_else(|| (f64::INFINITY, model.clone())))
}

/// From most to least: what grows with two terms is nearest to them.
const LENSES: [LensModel; 4] = [
    LensModel::OpenCv,
    LensModel::Radial,
    LensModel::SimpleRadial,
    LensModel::Pinhole,
];

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
