//! What decides a training before it begins: its own parameters, or the setup of another training.

use marf_field::{Config, Derived, Overrides};
use marf_scene::Scene;
use marf_schema::train::{Fit, Fold, Holdout, Memory, Setup, TrainParams};
use marf_stage::{Ctx, Document, Inputs, StageError};

use crate::{
    TrainError,
    memory::{MemoryPlan, plan_memory},
    settings::{field_config, field_keys, scale_to},
    split::Split,
};

/// Settings of a training, all resolved but the box and the sizes where no other training has derived them.
pub(super) struct Settings {
    pub steps: u64,
    pub scale: u32,
    pub memory: Memory,
    pub holdout: Holdout,
    pub fold: Option<Fold>,
    pub fit: Fit,
    /// Keys of the field that are set: trials leave them as they are.
    pub keys: Overrides,
    /// The field before trials change it.
    pub config: Config,
    /// What another training decided.
    pub given: Option<Given>,
}

/// What a training takes over that it would otherwise derive or find by trials.
pub(super) struct Given {
    kept_every: u32,
    pub derived: Derived,
}

impl Settings {
    /// Returns the setup that the input `of` names, or else what the parameters say for a training of `steps`.
    pub fn resolve(
        ctx: &Ctx<'_>,
        params: &TrainParams,
        inputs: &Inputs,
        scene: &Scene,
        steps: u64,
    ) -> Result<Self, StageError> {
        if let Some(digest) = inputs.optional(Setup::OUTPUT) {
            let setup = Setup::decode(&ctx.get(digest)?);
            let setup = setup.map_err(|error| TrainError::Setup(error.to_string()))?;
            return Ok(Self::of(setup, params.fold));
        }
        let steps = params.fold.map_or(steps, |fold| fold.steps_of(steps));
        let keys = field_keys(ctx, inputs, &params.field)?;
        let side_px = params.quality.longest_side_px();
        Ok(Self {
            steps,
            scale: params.scale.unwrap_or_else(|| scale_to(side_px, scene)),
            memory: params.memory,
            holdout: params.holdout,
            fold: params.fold,
            fit: params.fit,
            config: field_config(&keys, params.quality, params.fit, steps)?,
            keys,
            given: None,
        })
    }

    /// Takes over a setup; a fold trains its share of the steps, with step size and length of steps along rays to match.
    fn of(setup: Setup, fold: Option<Fold>) -> Self {
        let steps = fold.map_or(setup.steps, |fold| fold.steps_of(setup.steps));
        Self {
            steps,
            scale: setup.scale,
            memory: setup.memory,
            holdout: setup.holdout,
            fold: fold.or(setup.fold),
            fit: setup.fit,
            keys: Overrides::default(),
            config: Config {
                steps: Some(steps),
                ..setup.config
            },
            given: Some(Given {
                kept_every: setup.kept_every,
                derived: setup.derived,
            }),
        }
    }

    /// Returns how photos are kept: as in the training whose setup this is, or so that they fit the memory.
    pub fn plan_memory(&self, split: &Split<'_>, times: &[usize]) -> Result<MemoryPlan, TrainError> {
        let plan = plan_memory(self.memory, split, times, self.scale, &self.config)?;
        Ok(MemoryPlan {
            run: self.given.as_ref().map_or(plan.run, |given| given.kept_every),
            ..plan
        })
    }

    /// Returns the setup of the training after its end.
    pub fn setup(&self, kept_every: u32, config: &Config, derived: Derived) -> Setup {
        Setup {
            steps: self.steps,
            scale: self.scale,
            kept_every,
            memory: self.memory,
            holdout: self.holdout,
            fold: self.fold,
            fit: self.fit,
            config: config.clone(),
            derived,
        }
    }
}
