//! After how many steps a training ends, and what is fixed about its steps.

use serde::{Deserialize, Serialize};

use crate::Config;
use crate::frame::ENOUGH_POINTS;

/// Steps between two updates of the occupancy.
pub const UPDATE_EVERY: u64 = 16;
/// Adam's epsilon: gradients of a mean over the batch are about 1e-6, rounding noise is below 1e-12.
pub const EPSILON: f32 = 1e-12;
/// Pull of the networks' weights to zero (instant-ngp's l2).
pub const DECAY: f32 = 1e-6;
/// Step size of the background, in learning rates: its 16 coefficients a channel have no layer to multiply them.
pub const BACKGROUND_RATE: f32 = 10.0;
/// Fewest steps for each halving: before, there is no surface that shorter steps would find more exactly.
pub const STEPS_A_HALVING: u64 = 640;

/// Steps after which the box is fitted to the field, at least and at most, and this share of the training between.
const REFIT_AT: [u64; 2] = [64, 512];
const REFIT_SHARE: u64 = 8;

/// Returns the step after which the box is fitted to the field, a multiple of [`UPDATE_EVERY`].
///
/// `None` if enough sparse points have decided the box, or if the training has fewer than four times the least
/// such steps or an unknown length: everything learnt until then is lost.
pub fn refit_step(config: &Config, points: &[[f64; 3]]) -> Option<u64> {
    let [least, most] = REFIT_AT;
    let at = match (config.refit_steps, config.steps) {
        (Some(at), _) => u64::from(at),
        (None, Some(steps)) if steps >= 4 * least => (steps / REFIT_SHARE).clamp(least, most),
        (None, _) => 0,
    };
    let at = at / UPDATE_EVERY * UPDATE_EVERY;
    (at > 0 && points.len() < ENOUGH_POINTS).then_some(at)
}

/// The planned length of a training in steps, as first planned and as changed on its way.
///
/// Step size and length of steps along rays follow the share of the training that is done
/// ([`Schedule::done`]), and that follows this list alone. Two trainings of one schedule are equal to the
/// bit, at whatever time the first was planned. As JSON it is a list of pairs: the step before which it was
/// planned, and the steps of the whole training.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<[u64; 2]>", into = "Vec<[u64; 2]>")]
pub struct Schedule {
    planned: Vec<[u64; 2]>,
}

/// Most plans of a schedule.
const MOST_PLANS: usize = 1_000;

/// A list that is not a schedule.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{fault}: write `[[0, STEPS], [AT, STEPS], ...]`, 1 to {MOST_PLANS} pairs in the order of the steps AT"
)]
pub struct ScheduleError {
    fault: String,
}

impl Schedule {
    /// Returns the schedule of a training that was planned once, of at least 1 step.
    pub fn once(steps: u64) -> Self {
        Self {
            planned: vec![[0, steps.max(1)]],
        }
    }

    /// Changes the planned end after `at` steps, at least one further step. Of two plans after as many steps
    /// the later holds.
    pub fn plan(&mut self, at: u64, steps: u64) {
        self.planned.retain(|plan| plan[0] < at);
        self.planned.push([at, steps.max(at.saturating_add(1))]);
    }

    /// Returns the steps of the training as last planned.
    pub fn steps(&self) -> u64 {
        self.planned.last().map_or(1, |plan| plan[1])
    }

    /// Returns the steps as planned before the first one: what the sizes follow.
    pub fn first(&self) -> u64 {
        self.planned.first().map_or(1, |plan| plan[1])
    }

    /// Returns how often it was planned.
    pub fn plans(&self) -> usize {
        self.planned.len()
    }

    /// Returns the share of the training that is done after a number of steps, in [0, 1]. 1 beyond its end.
    ///
    /// If the end is changed, the share stays, and the rest is spread over the remaining steps.
    pub fn done(&self, steps: u64) -> f64 {
        self.place(steps).0
    }

    /// Returns the planned end after a number of steps.
    pub fn end_at(&self, steps: u64) -> u64 {
        self.place(steps).1
    }

    /// Returns the share that is done, and the end as planned then.
    fn place(&self, steps: u64) -> (f64, u64) {
        let (mut from, mut done, mut end) = (0, 0.0, self.first());
        for [at, planned] in self.planned.iter().filter(|plan| plan[0] <= steps) {
            done = along(from, done, end, *at);
            (from, end) = (*at, *planned);
        }
        (along(from, done, end, steps), end)
    }
}

/// Returns the share that is done after `steps`, where `done` was after `from` and all is at `end`.
fn along(from: u64, done: f64, end: u64, steps: u64) -> f64 {
    if steps >= end {
        return 1.0;
    }
    done + (1.0 - done) * ((steps - from) as f64 / (end - from) as f64)
}

impl TryFrom<Vec<[u64; 2]>> for Schedule {
    type Error = ScheduleError;

    fn try_from(planned: Vec<[u64; 2]>) -> Result<Self, ScheduleError> {
        let refuse = |fault: String| Err(ScheduleError { fault });
        if planned.is_empty() || planned.len() > MOST_PLANS {
            return refuse(format!("{} plans", planned.len()));
        }
        if planned[0][0] != 0 || planned[0][1] == 0 {
            return refuse(format!("the first plan is {:?}", planned[0]));
        }
        let follows = |pair: &[[u64; 2]]| pair[1][0] > pair[0][0] && pair[1][0] < pair[0][1];
        if let Some(pair) = planned.windows(2).find(|pair| !follows(pair)) {
            return refuse(format!("{:?} does not follow on {:?}", pair[1], pair[0]));
        }
        match planned.iter().find(|plan| plan[1] <= plan[0]) {
            Some(ended) => refuse(format!("{ended:?} ends before it is planned")),
            None => Ok(Self { planned }),
        }
    }
}

impl From<Schedule> for Vec<[u64; 2]> {
    fn from(schedule: Schedule) -> Self {
        schedule.planned
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::small;

    fn planned(plans: &[[u64; 2]]) -> Schedule {
        Schedule::try_from(plans.to_vec()).unwrap()
    }

    #[test]
    fn a_training_planned_once_is_done_in_equal_parts_to_the_bit() {
        for steps in [1, 3, 400, 100_003, 1 << 53, u64::MAX] {
            let once = Schedule::once(steps);
            for at in [0, 1, steps / 3, steps / 2, steps - 1, steps] {
                assert_eq!(once.done(at), at as f64 / steps as f64, "{at} of {steps}");
                assert_eq!(once.end_at(at), steps);
            }
            assert_eq!(
                [once.done(0), once.done(steps), once.done(u64::MAX)],
                [0.0, 1.0, 1.0]
            );
        }
        assert_eq!(Schedule::once(0).steps(), 1);
    }

    /// 1,000 steps planned, after 250 of them 500: a quarter is done, and 250 steps remain for three
    /// quarters. After 300 again 1,000: two fifths are done, and 700 steps remain.
    #[test]
    fn a_new_end_keeps_what_is_done_and_spreads_the_rest_over_the_steps_left() {
        let schedule = planned(&[[0, 1_000], [250, 500], [300, 1_000]]);
        for (at, done) in [
            (0, 0.0),
            (100, 0.1),
            (250, 0.25),
            (300, 0.4),
            (650, 0.7),
            (1_000, 1.0),
            (5_000, 1.0),
        ] {
            assert!(
                (schedule.done(at) - done).abs() < 1e-12,
                "{at}: {}",
                schedule.done(at)
            );
        }
        assert_eq!(
            (schedule.first(), schedule.steps(), schedule.plans()),
            (1_000, 1_000, 3)
        );
    }

    /// A training planned on its way and one that knows all plans from the start are at the same place, at
    /// the very step of a plan too. The older plan decides there in both.
    #[test]
    fn plans_of_later_steps_change_nothing_and_none_jumps() {
        let mut way = Schedule::once(977);
        let all = planned(&[[0, 977], [131, 500], [307, 2_111], [308, 309]]);
        for at in 0..=309 {
            let done = way.done(at);
            for [planned_at, steps] in Vec::from(all.clone()) {
                if planned_at == at && at > 0 {
                    way.plan(at, steps);
                }
            }
            assert_eq!(done.to_bits(), way.done(at).to_bits(), "{at}");
            assert_eq!(done.to_bits(), all.done(at).to_bits(), "{at}");
        }
        assert_eq!(way, all);
        way.plan(308, 400);
        assert_eq!(way.steps(), 400);
        way.plan(308, 1);
        assert_eq!(way, all);
    }

    #[test]
    fn what_is_no_schedule_is_refused_with_its_form() {
        let many: Vec<[u64; 2]> = (0..=MOST_PLANS as u64).map(|at| [at, 9_999]).collect();
        for (plans, fault) in [
            (vec![], "0 plans"),
            (vec![[1, 5]], "the first plan is [1, 5]"),
            (vec![[0, 0]], "the first plan is [0, 0]"),
            (vec![[0, 9], [9, 12]], "[9, 12] does not follow on [0, 9]"),
            (
                vec![[0, 9], [4, 12], [4, 13]],
                "[4, 13] does not follow on [4, 12]",
            ),
            (vec![[0, 9], [4, 4]], "[4, 4] ends before it is planned"),
            (many, "1001 plans"),
        ] {
            let error = Schedule::try_from(plans).unwrap_err().to_string();
            assert!(
                error.starts_with(fault) && error.contains("[[0, STEPS]"),
                "{error}"
            );
        }
        let read: Schedule = serde_json::from_str("[[0,9],[4,12]]").unwrap();
        assert_eq!(serde_json::to_string(&read).unwrap(), "[[0,9],[4,12]]");
    }

    #[test]
    fn the_box_is_fitted_after_an_eighth_of_a_training_that_is_long_enough() {
        let at = |steps, refit_steps, points: usize| {
            let config = Config {
                steps,
                refit_steps,
                ..small()
            };
            refit_step(&config, &vec![[0.0; 3]; points])
        };
        for (steps, expected) in [
            (1, None),
            (2, None),
            (3, None),
            (255, None),
            (256, Some(64)),
            (400, Some(64)),
            (1_000, Some(112)),
            (100_000, Some(512)),
            (u64::MAX, Some(512)),
        ] {
            assert_eq!(at(Some(steps), None, 0), expected, "{steps}");
        }
        assert_eq!(at(Some(4_000), None, 31), Some(496));
        assert_eq!(at(Some(4_000), None, 32), None);
        assert_eq!(at(None, None, 0), None);
        assert_eq!(at(Some(10), Some(100), 0), Some(96));
        assert_eq!(at(Some(4_000), Some(0), 0), None);
        assert_eq!(at(Some(4_000), Some(15), 0), None);
    }
}
