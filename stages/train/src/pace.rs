use std::time::{Duration, Instant};

use marf_field::{EXPECTED_STEPS_PER_S, Trainer};
use marf_schema::{
    output::SCENE,
    pace::{PaceParams, Steps},
    tune::BestParams,
};
use marf_stage::{
    Ctx, Define, Document, Inputs, Outputs, ParamError, Params, Port, Set, StageError, TypedOutputs,
};

use crate::{
    TrainError,
    io::read_scene,
    memory::plan_memory,
    photos::PhotoReader,
    settings::{field_config, field_keys, scale_to},
    split::split,
    stage_on_device,
    views::{new_trainer, training_views},
};

/// Longest measurement, seconds.
const LONGEST_S: f64 = 8.0;

/// Turns a time to train for into optimiser steps, once, by training for a moment on this machine.
///
/// The one stage whose answer depends on the clock: its record keeps the steps that were found, so that every run on
/// the same store trains the same steps.
#[derive(Debug)]
pub struct Pace {
    params: PaceParams,
}

impl Define for Pace {
    type Params = PaceParams;
    const NAME: &'static str = PaceParams::STAGE;
    const ABOUT: &'static str = "Measures how many training steps a time budget buys on this machine";
    const VERSION: u32 = 4;
    const PORTS: &'static [Port] = &[
        Port::required("input", SCENE),
        Port::optional("params", BestParams::OUTPUT),
    ];
    const OUTPUTS: &'static [&'static str] = &[Steps::OUTPUT];

    fn new(params: PaceParams) -> Result<Self, ParamError> {
        params.check()?;
        Ok(Self { params })
    }
}

stage_on_device!(Pace, Set, "it measures how fast this machine trains");

impl Set for Pace {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let params = &self.params;
        let scene = read_scene(ctx, inputs)?;
        let keys = field_keys(ctx, inputs, &params.field)?;
        let expected = (params.budget.seconds() * EXPECTED_STEPS_PER_S) as u64;
        let config = field_config(&keys, params.quality, params.fit, expected)?;
        let side_px = params.quality.longest_side_px();
        let scale = params.scale.unwrap_or_else(|| scale_to(side_px, &scene));
        let split = split(&scene, params.holdout, None)?;
        let times = vec![1; split.training.len()];
        let plan = plan_memory(params.memory, &split, &times, scale, &config)?;
        let photos = PhotoReader::new(ctx, &scene, scale);
        let views = training_views(&photos, &split.training, &times, plan, 0)?;
        let mut trainer = new_trainer(views, &scene, &config, 0, None, &params.device)?;
        let budget_s = params.budget.seconds();
        let rate = steps_per_second(ctx, &mut trainer, (budget_s / 4.0).min(LONGEST_S))?;
        let mut outputs = Outputs::new();
        outputs.put(ctx, &Steps(steps_in(budget_s, rate)))?;
        Ok(outputs)
    }
}

/// Trains for `measure_s` seconds and returns the rate of the second half, when the grid has been pruned once.
fn steps_per_second(ctx: &Ctx<'_>, trainer: &mut Trainer, measure_s: f64) -> Result<f64, StageError> {
    let half = Duration::from_secs_f64(measure_s / 2.0);
    run_for(ctx, trainer, half, "warming up")?;
    let begun = Instant::now();
    let before = trainer.steps();
    run_for(ctx, trainer, half, "measuring")?;
    Ok((trainer.steps() - before) as f64 / begun.elapsed().as_secs_f64())
}

/// Trains for a time, at least one step.
fn run_for(ctx: &Ctx<'_>, trainer: &mut Trainer, time: Duration, note: &str) -> Result<(), StageError> {
    let begun = Instant::now();
    loop {
        ctx.check()?;
        trainer.advance(u64::MAX).map_err(TrainError::from)?;
        let elapsed = begun.elapsed();
        let done = elapsed.min(time).as_millis() as u64;
        ctx.progress.at(done, time.as_millis() as u64, note);
        if elapsed >= time {
            return Ok(());
        }
    }
}

/// Returns the steps that a budget buys, at least one.
fn steps_in(budget_s: f64, steps_per_second: f64) -> u64 {
    ((budget_s * steps_per_second) as u64).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_buys_whole_steps_and_at_least_one() {
        assert_eq!(steps_in(60.0, 12.34), 740);
        assert_eq!(steps_in(0.001, 12.0), 1);
        assert_eq!(steps_in(60.0, f64::NAN), 1);
    }
}
