use marf_scene::Camera;

use super::refine::{adjust_all, settle};
use super::{MapError, Model, Task};
use crate::bundle::{LensModel, information_criterion};

/// Which lens terms a scene gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LensChoice {
    /// The smallest model the data support; while a scene grows, this one.
    Smallest { growing: LensModel },
    Fixed(LensModel),
}

impl LensChoice {
    pub(super) fn while_growing(self) -> LensModel {
        match self {
            Self::Smallest { growing } => growing,
            Self::Fixed(lens) => lens,
        }
    }
}

/// Chooses the lens model and adjusts a last time, the principal point too if it was asked for.
pub(super) fn finish(task: &Task<'_>, model: &mut Model) -> Result<(), MapError> {
    if matches!(task.options.lens, LensChoice::Smallest { .. }) {
        *model = smallest(task, model)?;
    }
    settle(task, model, &[], 4)?;
    if task.options.principal_point {
        model.principal_point = true;
        settle(task, model, &[], 2)?;
    }
    Ok(())
}

/// The adjusted model with the lens whose information criterion is lowest, from many terms to few: when fewer
/// terms make it worse, still fewer are not tried.
fn smallest(task: &Task<'_>, model: &Model) -> Result<Model, MapError> {
    let mut best: Option<(f64, Model)> = None;
    for lens in [
        LensModel::OpenCv,
        LensModel::Radial,
        LensModel::SimpleRadial,
        LensModel::Pinhole,
    ] {
        let mut trial = model.clone();
        trial.lens = lens;
        trial.cameras = model.cameras.iter().map(|camera| cut(camera, lens)).collect();
        let report = adjust_all(task, &mut trial, &[], 15)?;
        let score = information_criterion(&report);
        let worse = best.as_ref().is_some_and(|(lowest, _)| score >= *lowest);
        if !worse {
            best = Some((score, trial));
        } else if lens < LensModel::Radial {
            break;
        }
    }
    Ok(best.map_or_else(|| model.clone(), |(_, model)| model))
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
