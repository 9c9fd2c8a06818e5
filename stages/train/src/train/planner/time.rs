//! The end of a training by the clock, planned again as the time passes.

use std::time::Instant;

use marf_field::{Trainer, steps_in};
use serde::{Deserialize, Serialize};

use super::judging::kept_s;

/// Part of the time after which the end is planned again.
const PLANNED_EVERY: f64 = 1.0 / 32.0;
/// The end is not moved by less than this share of the remaining steps.
const LEAST_CHANGE: f64 = 0.01;
/// Weight of the rate since the last plan against the rates before it.
const NEWEST: f64 = 0.5;
/// Steps before which a field is a fog, whose renders say nothing about those at the end.
const CLEAR_AT: u64 = 1_280;
/// Part of the wait after which judging is measured again.
const JUDGED_EVERY: f64 = 1.0 / 12.0;

/// The time of a training. Part of a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct TrainingTime {
    /// Seconds that it may take.
    pub budget_s: f64,
    /// Seconds of these that it has taken.
    pub used_s: f64,
    /// Where judging is part of the same time.
    pub reserve: Option<JudgingReserve>,
}

/// The part of a wait that is kept for judging.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct JudgingReserve {
    /// Seconds of the whole wait.
    wait_s: f64,
    /// Photos that could be judged.
    photos: usize,
    /// Seconds kept for judging them, or for as many as there is time for.
    judging_s: f64,
    /// Seconds that the training had taken when judging was measured.
    measured_at_s: f64,
    /// After how many more it is measured again.
    measured_every_s: f64,
}

impl JudgingReserve {
    /// Returns the reserve of `judging_s` seconds for `photos`, measured after `used_s` seconds of a wait.
    pub fn new(wait_s: f64, photos: usize, judging_s: f64, used_s: f64) -> Self {
        Self {
            wait_s,
            photos,
            judging_s,
            measured_at_s: used_s,
            measured_every_s: wait_s * JUDGED_EVERY,
        }
    }
}

/// Plans the end of a training by its time.
pub(super) struct TimePlan {
    /// As it was at the beginning, with the budget as planned last.
    time: TrainingTime,
    began: Instant,
    /// Steps when the end was last planned.
    planned_at: u64,
    /// Seconds used when the end was last planned.
    planned_at_s: f64,
    /// Steps a second, averaged over the plans.
    rate: Option<f64>,
}

impl TimePlan {
    /// Starts the clock after `steps`.
    pub fn new(time: TrainingTime, steps: u64) -> Self {
        Self {
            time,
            began: Instant::now(),
            planned_at: steps,
            planned_at_s: time.used_s,
            rate: None,
        }
    }

    /// Returns the time with the seconds used until now.
    pub fn time(&self) -> TrainingTime {
        TrainingTime {
            used_s: self.time.used_s + self.began.elapsed().as_secs_f64(),
            ..self.time
        }
    }

    /// Returns whether judging is to be measured again: it takes longer with every halving of the steps along rays.
    pub fn is_to_judge(&self, steps: u64) -> bool {
        let since_s = |reserve: JudgingReserve| self.time().used_s - reserve.measured_at_s;
        let is_due = |reserve: JudgingReserve| since_s(reserve) > reserve.measured_every_s;
        steps >= CLEAR_AT && self.time.reserve.is_some_and(is_due)
    }

    /// Keeps time for judging, where a photo takes `photo_s` seconds.
    pub fn reserve_judging(&mut self, photo_s: f64) {
        let used_s = self.time().used_s;
        if let Some(reserve) = &mut self.time.reserve {
            let judging_s = kept_s(photo_s, reserve.photos, reserve.wait_s);
            self.time.budget_s += reserve.judging_s - judging_s;
            (reserve.judging_s, reserve.measured_at_s) = (judging_s, used_s);
        }
    }

    /// Plans the end of a training again if it is time to and it has not come.
    pub fn plan(&mut self, trainer: &mut Trainer) {
        let (steps, end) = (trainer.steps(), trainer.schedule().steps());
        let planned = (steps < end).then(|| self.end(steps, end, self.time().used_s));
        if let Some(end) = planned.flatten() {
            trainer.plan(end);
        }
    }

    /// Returns the new end of a training that was to end after `end` steps, if it should be moved.
    fn end(&mut self, steps: u64, end: u64, used_s: f64) -> Option<u64> {
        let left_s = self.time.budget_s - used_s;
        if left_s <= 0.0 {
            return (steps + 1 < end).then_some(steps + 1);
        }
        let (before, since_s) = (self.planned_at, used_s - self.planned_at_s);
        if since_s < self.time.budget_s * PLANNED_EVERY || steps == before {
            return None;
        }
        let newest = (steps - before) as f64 / since_s;
        let rate = self
            .rate
            .map_or(newest, |rate| NEWEST * newest + (1.0 - NEWEST) * rate);
        (self.planned_at, self.planned_at_s) = (steps, used_s);
        self.rate = Some(rate);
        let planned = steps + steps_in(left_s, rate);
        let change = planned.abs_diff(end) as f64;
        (change > LEAST_CHANGE * (end.saturating_sub(steps)) as f64).then_some(planned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn started(budget_s: f64) -> TimePlan {
        let time = TrainingTime {
            budget_s,
            used_s: 0.0,
            reserve: None,
        };
        TimePlan::new(time, 0)
    }

    /// Of 64 s, looked at every 2 s: 100 steps a second as planned change nothing. Half as many move the end by the remaining time at the
    /// mean of both rates. When the time is over, the next step is the last.
    #[test]
    fn the_end_follows_the_rate_and_the_time_that_is_left() {
        let mut clock = started(64.0);
        assert_eq!(clock.end(100, 6_400, 1.0), None, "too early");
        assert_eq!(clock.end(200, 6_400, 2.0), None, "as planned");
        assert_eq!(clock.end(300, 6_400, 4.0), Some(300 + 75 * 60));
        assert_eq!(clock.end(300, 4_800, 9.0), None, "no step since");
        assert_eq!(clock.end(4_000, 4_800, 64.0), Some(4_001));
        assert_eq!(clock.end(4_001, 4_001, 65.0), None);
        let mut clock = started(64.0);
        assert_eq!(
            clock.end(201, 6_400, 2.0),
            None,
            "less than a hundredth of the remaining time"
        );
    }

    /// Whatever the rate does, a training ends within a tenth of its time. Only one that becomes faster at the end ends early.
    #[test]
    fn a_training_ends_with_its_time_at_any_rate() {
        let rates: [fn(f64) -> f64; 4] = [
            |_| 90.0,
            |used_s| if used_s < 30.0 { 200.0 } else { 40.0 },
            |used_s| if used_s < 55.0 { 20.0 } else { 120.0 },
            |used_s| {
                if (used_s as u64).is_multiple_of(7) {
                    5.0
                } else {
                    150.0
                }
            },
        ];
        for (at, rate) in rates.into_iter().enumerate() {
            let (mut clock, mut end, mut steps, mut used_s) = (started(60.0), 100_000, 0, 0.0);
            while steps < end {
                used_s += 1.0 / rate(used_s);
                steps += 1;
                end = clock.end(steps, end, used_s).unwrap_or(end);
            }
            assert!((55.0..=60.5).contains(&used_s), "rate {at}: {used_s} s");
        }
    }
}
