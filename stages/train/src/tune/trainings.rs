//! The trainings that a search asks for.

use marf_field::Overrides;
use marf_schema::{
    train::{Holdout, TrainParams},
    tune::TuneParams,
};
use marf_stage::{Inputs, NodeSpec, StageError};

use super::sampling::sample_params;

/// Returns the training of a trial with another seed.
pub(super) fn scatter(params: &TuneParams, trial: u32, inputs: &Inputs) -> Result<NodeSpec, StageError> {
    let set = sample_params(&params.space, params.seed, trial);
    let train = train_of(params, params.seed.wrapping_add(1), &set);
    NodeSpec::new(format!("scatter-{trial:02}"), &train, inputs)
}

/// Returns the training of one parameter set, judged on validation photos.
pub(super) fn train_of(params: &TuneParams, seed: u64, set: &Overrides) -> TrainParams {
    TrainParams {
        quality: params.quality,
        steps: Some(params.horizon()),
        seed,
        scale: params.scale,
        holdout: Holdout::Validation,
        field: params.field.with(set),
        device: params.device.clone(),
        ..TrainParams::default()
    }
}
