use std::ops::Range;

use marf_field::{Field, Schedule, Trainer};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use super::{
    target::{PsnrTarget, TargetLooks},
    time::{TimePlan, TrainingTime},
};

/// Measures the seconds that judging a photo will take when the field is trained.
type JudgingTime<'a> = dyn Fn(&mut Trainer) -> Result<f64, StageError> + 'a;

/// Decides after how many steps a training ends: those of its schedule, fewer if it has to stop before or reaches its target, and the
/// number that fits its time.
pub(crate) struct Planner<'a> {
    /// The schedule at step 0.
    pub schedule: Schedule,
    /// Steps after which it stops before its end.
    pub until: Option<u64>,
    /// The time that it may take: the end is planned again as it passes.
    pub time: Option<TrainingTime>,
    /// Measures judging, where that is part of the same time.
    pub photo_s: Option<&'a JudgingTime<'a>>,
    /// The quality at which it stops.
    pub target: Option<PsnrTarget<'a>>,
    /// The clock of its steps.
    clock: Option<TimePlan>,
}

/// Measurements and plan of a planner. Part of a checkpoint.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct PlannerState {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<TrainingTime>,
    /// The schedule that the time has led to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<Schedule>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    looks: Option<TargetLooks>,
}

impl PlannerState {
    /// Returns whether it holds nothing: the training has neither time nor target.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the looks at the field so far.
    pub fn looks(&self) -> TargetLooks {
        self.looks.clone().unwrap_or_default()
    }
}

impl<'a> Planner<'a> {
    /// Returns the planner of all steps of a schedule.
    pub fn new(schedule: Schedule) -> Self {
        Self {
            schedule,
            until: None,
            time: None,
            photo_s: None,
            target: None,
            clock: None,
        }
    }

    /// Starts the clock, from the time of an unfinished run if there was one.
    pub fn start(&mut self, state: &PlannerState, trainer: &mut Trainer) {
        let Some(time) = self.time else {
            return;
        };
        if let Some(schedule) = &state.schedule {
            trainer.follow(schedule.clone());
        }
        self.clock = Some(TimePlan::new(state.time.unwrap_or(time), trainer.steps()));
    }

    /// Returns after how many steps the training stops, as planned so far.
    pub fn end(&self, trainer: &Trainer) -> u64 {
        self.until.unwrap_or(trainer.schedule().steps())
    }

    /// Plans the end again after the steps taken last.
    ///
    /// # Errors
    /// Those of a render that measures judging.
    pub fn replan(&mut self, trainer: &mut Trainer) -> Result<(), StageError> {
        let Some(clock) = &mut self.clock else {
            return Ok(());
        };
        if let Some(photo_s) = self.photo_s.filter(|_| clock.is_to_judge(trainer.steps())) {
            clock.reserve_judging(photo_s(trainer)?);
        }
        clock.plan(trainer);
        Ok(())
    }

    /// Writes the time used so far, with the schedule, into a state.
    pub fn record(&self, trainer: &Trainer, state: &mut PlannerState) {
        state.time = self.clock.as_ref().map(TimePlan::time);
        state.schedule = self.clock.as_ref().map(|_| trainer.schedule().clone());
    }

    /// Returns whether the field is to be compared with its target after these steps.
    pub fn is_target_due(&self, taken: &Range<u64>, schedule: &Schedule) -> bool {
        let target = self.target.as_ref();
        target.is_some_and(|target| target.is_due(taken, schedule.steps()))
    }

    /// Compares the field with its target after `steps`, and returns whether it has it.
    ///
    /// # Errors
    /// Those of a render.
    pub fn look(
        &self,
        ctx: &Ctx<'_>,
        state: &mut PlannerState,
        field: &Field,
        schedule: &Schedule,
        steps: u64,
    ) -> Result<bool, StageError> {
        let Some(target) = &self.target else {
            return Ok(false);
        };
        let mut looks = state.looks();
        let has_target = target.look(ctx, &mut looks, field, schedule, steps)?;
        state.looks = Some(looks);
        Ok(has_target)
    }

    /// Returns the note on the target and its looks for the progress.
    pub fn note(&self, state: &PlannerState) -> String {
        let target = self.target.as_ref().zip(state.looks.as_ref());
        target.map_or_else(String::new, |(target, looks)| looks.note(target.psnr))
    }
}
