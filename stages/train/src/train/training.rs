//! A training at step 0: its photos are read.

use marf_field::Trainer;
use marf_schema::train::TrainParams;
use marf_stage::StageError;

use super::{
    plan::Plan,
    planner::Planner,
    training_loop::{Run, curve_photos},
};
use crate::{
    photos::{PhotoReader, ScaledPhoto},
    split::NamedFrame,
    views::{new_trainer, training_views},
};

/// A training at step 0.
pub(super) struct Training<'a> {
    pub trainer: Trainer,
    pub curve_photos: Vec<(NamedFrame<'a>, ScaledPhoto)>,
}

impl<'a> Training<'a> {
    /// Reads the photos.
    ///
    /// # Errors
    /// A photo that cannot be read, or the errors of a training.
    pub fn new(params: &TrainParams, plan: &Plan<'a>, photos: &PhotoReader<'_>) -> Result<Self, StageError> {
        let (split, times) = (&plan.photos.split, &plan.photos.times);
        let curve_photos = curve_photos(photos, &split.held_out, plan.memory.at_once)?;
        let views = training_views(photos, &split.training, times, plan.memory, params.seed)?;
        let views = plan.distances.give_to(views);
        Ok(Self {
            trainer: new_trainer(
                views,
                plan.photos.scene,
                &plan.settings.config,
                plan.begin(),
                params,
            )?,
            curve_photos,
        })
    }
}

/// Returns the run of a training that a planner ends.
pub(super) fn run_of<'r>(
    plan: &'r Plan<'_>,
    curve_photos: &'r [(NamedFrame<'r>, ScaledPhoto)],
    planner: Planner<'r>,
) -> Run<'r> {
    Run {
        from: plan.start.state.as_deref(),
        curve_photos,
        ..Run::new(planner, "training", plan.identity)
    }
}
