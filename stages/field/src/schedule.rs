//! What changes with the steps of a training: step size, averaging, rays of a batch, length of the steps along rays.

use serde::{Deserialize, Serialize};

use crate::Config;
use crate::depth::SHARE;
use crate::frame::ENOUGH_POINTS;
use crate::training::Training;

/// Steps between two updates of the occupancy.
pub const UPDATE_EVERY: u64 = 16;
/// Adam's epsilon: gradients of a mean over the batch are about 1e-6, rounding noise is below 1e-12.
pub const EPSILON: f32 = 1e-12;
/// Pull of the networks' weights to zero (instant-ngp's l2).
pub const DECAY: f32 = 1e-6;
/// Step size of the background, in learning rates: its 16 coefficients a channel have no layer to multiply them.
pub const BACKGROUND_RATE: f32 = 10.0;
/// Share of the training after which the steps along rays are halved for the last time, the other times in equal parts
/// before: long steps find a surface sooner, short ones place it better.
const LAST_HALVED: f64 = 0.9;
/// Steps for which the rate stays at least: a training of 400 steps lost .6 dB where it fell from the start.
const RATE_HELD: u64 = 512;
/// Fewest steps for each halving: before, there is no surface that shorter steps would find more exactly.
pub const STEPS_A_HALVING: u64 = 640;
/// Step size of a training that starts from a field, as a share of that of one from nothing: moments are zero, so its first steps move
/// every weight by about the whole of it. `benches/field.md`.
const WARM_RATE: f64 = 0.5;
/// With fewer samples a ray than this the steps are halved at once; checked every [`FEW_AT`] steps.
const FEW_SAMPLES: f64 = 8.0;
const FEW_AT: u64 = 128;
/// Samples a chunk of rays aims at: its rows then stay in the second cache.
const CHUNK_SAMPLES: f64 = 768.0;
/// Steps between two updates of the averaged weights: every step costs a pass over all tables.
const AVERAGED_EVERY: u64 = 4;

/// Steps after which the box is fitted to the field, at least and at most, and this share of the training between.
const REFIT_AT: [u64; 2] = [64, 512];
const REFIT_SHARE: u64 = 8;

/// Returns the step after which the box is fitted to the field, a multiple of [`UPDATE_EVERY`].
///
/// `None` where enough sparse points have told it, and where the training is less than four times as long or its length
/// is not known: what was learnt until then is lost.
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

/// After how many steps a training ends, as it was planned before the first step and planned anew on its way.
///
/// Step size and length of steps along rays follow the share of the training that is done ([`Schedule::done`]), and that
/// follows this list alone: two trainings of one schedule are equal to the bit, whatever the clock said when the first was
/// planned. As JSON a list of pairs: the step before which it was planned, and the steps of the whole training.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<[u64; 2]>", into = "Vec<[u64; 2]>")]
pub struct Schedule {
    planned: Vec<[u64; 2]>,
}

/// Most plans of a schedule.
const MOST_PLANS: usize = 1_000;

/// A list that is no schedule.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{fault}; write `[[0, STEPS], [AT, STEPS], ...]`, 1 to {MOST_PLANS} pairs in the order of the steps AT"
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

    /// Plans the end anew after `at` steps, at least one further step; of two plans after as many steps the later holds.
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

    /// Returns the share of the training that is done after so many steps, in [0, 1]; 1 beyond its end.
    ///
    /// Where the end is planned anew the share stays, and what is left is spread over the steps that are left.
    pub fn done(&self, steps: u64) -> f64 {
        self.place(steps).0
    }

    /// Returns the end as it was planned after so many steps.
    pub fn end_at(&self, steps: u64) -> u64 {
        self.place(steps).1
    }

    /// Returns the share that is done, and the end as planned then.
    fn place(&self, steps: u64) -> (f64, u64) {
        let (mut from, mut done, mut end) = (0, 0.0, self.first());
        for [at, planned] in self.planned.iter().filter(|plan| plan[0] <= steps) {
            done = along((from, done), end, *at);
            (from, end) = (*at, *planned);
        }
        (along((from, done), end, steps), end)
    }
}

/// Returns the share that is done after `steps`, where `done` was after `from` and all is at `end`.
fn along((from, done): (u64, f64), end: u64, steps: u64) -> f64 {
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

impl Training {
    /// Returns the step size after so many steps: `learning_rate` for half of the training and at least 512 steps, then down by
    /// equal factors to `final_rate` of it at the end, where it stays. After a new plan as in a training that was planned so
    /// from the start and is as far, to whole steps. Half of that, and never held for 512 steps, where it starts from a field.
    pub fn rate_at(&self, steps: u64) -> f32 {
        let (done, end) = self.schedule.place(steps);
        let (least, share) = match self.halved_before {
            None => (RATE_HELD, 1.0),
            Some(_) => (0, WARM_RATE),
        };
        let held = (end / 2).max(least);
        let past = (done * end as f64).round_ties_even() - held as f64;
        let fallen = past.max(0.0) / end.saturating_sub(held).max(1) as f64;
        let first = self.config.learning_rate * share;
        (first * libm::pow(self.config.final_rate, fallen)) as f32
    }

    /// Returns the share of themselves that the averaged weights keep after so many steps, less in the first ones.
    pub fn kept_at(&self, steps: u64) -> Option<f32> {
        let step = steps as f32;
        let once = (self.config.average as f32).min((1.0 + step) / (10.0 + step));
        let steps = steps + 1;
        if steps < 4 * AVERAGED_EVERY {
            return Some(once);
        }
        let is_due = steps.is_multiple_of(AVERAGED_EVERY);
        is_due.then(|| (0..AVERAGED_EVERY).fold(1.0, |product, _| product * once))
    }

    /// Returns the weight of a pull in a step of so many rays; `None` where no point pulls, or no longer.
    pub fn pull_at(&self, step: u64, rays: usize) -> Option<f32> {
        let fading = 1.0 - step as f64 / f64::from(self.sizes.depth_steps.value);
        let weight = self.config.depth_weight * fading * SHARE as f64 / rays as f64;
        (!self.observations.is_empty() && fading > 0.0).then_some(weight as f32)
    }

    /// Returns the weight of the distortion loss after so many steps.
    pub fn distortion_at(&self, steps: u64) -> f32 {
        let [first, last] = self.sizes.distortion.value;
        let done = self.schedule.done(steps);
        ((last - first) * done).mul_add(done, first) as f32
    }

    /// Returns the pull of the tables to zero after so many steps.
    pub fn table_decay_at(&self, steps: u64) -> f32 {
        let left = 1.0 - self.schedule.done(steps);
        (self.sizes.table_decay.value * left * left) as f32
    }

    /// Halves the steps along rays once there is a surface to find more exactly.
    pub fn halve_steps(&mut self) {
        let most = self.sizes.halvings.value;
        let due = self.halvings_due(self.state.steps);
        let few = self.state.samples_per_ray < FEW_SAMPLES && self.state.steps.is_multiple_of(FEW_AT);
        let wanted = due.max(self.state.halvings + u32::from(few));
        let wanted = wanted.min(most);
        if wanted > self.state.halvings {
            self.state.samples_per_ray *= f64::from(1_u32 << (wanted - self.state.halvings));
            self.state.halvings = wanted;
            self.march = self.sizes.steps(&self.config, wanted);
        }
    }

    /// Returns how often the steps along rays are halved by then, whatever few samples ask for. From a field as often as it was, or
    /// more where there are steps for it, but anew: as many samples with long steps are more rays, which new photos need.
    pub fn halvings_due(&self, steps: u64) -> u32 {
        let most = self.sizes.halvings.value;
        let long = |steps: u64| ((steps / STEPS_A_HALVING) as u32).min(most);
        let due = |most: u32| (self.schedule.done(steps) / LAST_HALVED * f64::from(most)) as u32;
        match self.halved_before {
            None => due(most).min(long(steps)),
            Some(before) => {
                let last = before.max(long(self.schedule.steps()));
                due(last).min(last)
            }
        }
    }

    /// Returns how many samples of a ray are trained in the next step, about; 0: all that show.
    ///
    /// All while steps along rays are as long as at first: there is no surface yet to choose by.
    pub fn ray_samples(&self) -> u32 {
        match self.state.halvings {
            0 => 0,
            _ => self.config.ray_samples,
        }
    }

    /// Returns the rays of the next step, a whole number of chunks.
    pub fn ray_count(&self) -> usize {
        let rays = f64::from(self.config.batch_samples) / self.state.samples_per_ray;
        (rays as usize).max(1).next_multiple_of(self.chunk_rays())
    }

    /// Returns the rays of a chunk.
    pub fn chunk_rays(&self) -> usize {
        (CHUNK_SAMPLES / self.state.samples_per_ray).clamp(4.0, 64.0) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, small};

    fn of(steps: Option<u64>) -> Training {
        let config = Config {
            steps,
            halvings: Some(3),
            ..small()
        };
        Training::new(ball(2, 8), &[], &config, 0).unwrap()
    }

    #[test]
    fn the_rate_is_held_for_half_of_the_training_and_ends_at_its_last_share() {
        for (steps, last) in [(1, 1.0), (3, 1.0), (400, 1.0), (100_000, 0.05), (u64::MAX, 0.05)] {
            let training = of(Some(steps));
            let shares = [0, steps / 2, steps, u64::MAX]
                .map(|step| f64::from(training.rate_at(step)) / training.config.learning_rate);
            for (share, expected) in shares.into_iter().zip([1.0, 1.0, last, last]) {
                assert!((share / expected - 1.0).abs() < 1e-6, "{steps}: {shares:?}");
            }
        }
        // Unknown: as 4,000 steps.
        assert_eq!(of(None).rate_at(3_210), of(Some(4_000)).rate_at(3_210));
    }

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

    /// 1,000 steps planned, after 250 of them 500: a quarter is done, and 250 steps are left for three quarters; after 300
    /// again 1,000: two fifths are done, and 700 steps are left.
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

    /// A training that is planned on its way and one that knows all plans from the start are at the same place, at the very
    /// step of a plan too: what was decided there by the older plan is decided so again.
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
    fn steps_along_rays_are_halved_in_equal_parts_of_nine_tenths_of_the_training() {
        for (steps, expected) in [(3_000, [900, 1_800, 2_700]), (100_000, [30_000, 60_000, 90_000])] {
            let mut training = of(Some(steps));
            training.state.samples_per_ray = 100.0;
            for (done, at) in expected.into_iter().enumerate() {
                let before = training.march.count;
                training.state.steps = at - 1;
                training.halve_steps();
                let early = training.state.halvings;
                training.state.steps = at;
                training.halve_steps();
                let halvings = [early, training.state.halvings];
                assert_eq!(halvings, [done as u32, done as u32 + 1], "{steps}, {at}");
                assert!(training.march.count > before, "{steps}, {at}");
            }
            assert_eq!(training.state.samples_per_ray, 800.0, "{steps}");
        }
    }

    /// In 1,000 steps all four halvings are made again, in equal parts of nine tenths; 10,000 are enough for all six.
    #[test]
    fn from_a_field_the_steps_along_rays_are_longer_at_first_and_as_long_at_the_end() {
        for (before, steps, expected) in [
            (
                4,
                1_000,
                [(0, 0), (224, 0), (226, 1), (676, 3), (900, 4), (1_000, 4)],
            ),
            (
                4,
                10_000,
                [(0, 0), (1_499, 0), (1_501, 1), (4_501, 3), (8_999, 5), (9_000, 6)],
            ),
            (0, 16, [(0, 0), (1, 0), (8, 0), (14, 0), (15, 0), (16, 0)]),
            (1, 16, [(0, 0), (1, 0), (8, 0), (14, 0), (15, 1), (16, 1)]),
        ] {
            let mut training = of(Some(steps));
            (training.halved_before, training.sizes.halvings.value) = (Some(before), 6);
            for (at, halvings) in expected {
                assert_eq!(training.halvings_due(at), halvings, "{before}, {steps}: {at}");
            }
        }
    }

    #[test]
    fn from_a_field_half_the_rate_falls_in_the_second_half_however_short() {
        let mut training = of(Some(400));
        let config = &training.config;
        let (rate, last) = (config.learning_rate as f32, config.final_rate as f32);
        training.halved_before = Some(0);
        assert_eq!([0, 200].map(|step| training.rate_at(step)), [rate / 2.0; 2]);
        assert!(training.rate_at(201) < rate / 2.0);
        assert!((training.rate_at(400) / (rate / 2.0 * last) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn short_trainings_halve_their_steps_only_after_enough_of_them() {
        for (steps, at, halvings) in [
            (1, 1, 0),
            (400, 400, 0),
            (1_000, 639, 0),
            (1_000, 640, 1),
            (1_000, 1_000, 1),
            (1_500, 1_280, 2),
        ] {
            let mut training = of(Some(steps));
            training.state.samples_per_ray = 100.0;
            training.state.steps = at;
            training.halve_steps();
            assert_eq!(training.state.halvings, halvings, "{steps}, {at}");
        }
    }

    #[test]
    fn rays_with_few_samples_have_their_steps_halved_at_once() {
        let mut training = of(Some(100_000));
        training.state.samples_per_ray = 3.0;
        for (steps, halvings) in [(16, 0), (128, 1), (144, 1), (256, 2), (384, 2)] {
            training.state.steps = steps;
            training.halve_steps();
            assert_eq!(training.state.halvings, halvings, "{steps}");
        }
    }

    #[test]
    fn points_pull_less_and_less_and_no_longer_after_their_steps() {
        let points: Vec<[f64; 3]> = (0..64).map(|k| [0.0, 0.0, 0.01 * f64::from(k)]).collect();
        for last in [1, 200, u32::MAX] {
            let config = Config {
                depth_steps: Some(last),
                ..small()
            };
            let training = Training::new(ball(2, 8), &points, &config, 0).unwrap();
            let pull = |step: u32| training.pull_at(step.into(), 100).map_or(0.0, f64::from);
            assert!(pull(last - 1) > 0.0, "{last}");
            assert_eq!(pull(last), 0.0, "{last}");
            let half = pull(last / 2) / pull(0);
            assert!(last == 1 || (half - 0.5).abs() < 1e-6, "{last}: {half}");
        }
    }

    #[test]
    fn the_distortion_loss_grows_with_the_square_of_what_is_done() {
        let mut training = of(Some(1_000));
        for (weights, expected) in [
            ([0.0, 0.1], [0.0, 0.1 / 16.0, 0.1 / 4.0, 0.1, 0.1]),
            ([0.03, 0.03], [0.03; 5]),
            ([1.0, 0.0], [1.0, 15.0 / 16.0, 0.75, 0.0, 0.0]),
        ] {
            training.sizes.distortion.value = weights;
            for (steps, expected) in [0, 250, 500, 1_000, u64::MAX].into_iter().zip(expected) {
                let found = f64::from(training.distortion_at(steps));
                assert!((found - expected).abs() < 1e-8, "{weights:?}, {steps}: {found}");
            }
        }
    }

    #[test]
    fn the_pull_of_the_tables_falls_with_the_square_of_what_is_left() {
        let mut training = of(Some(1_000));
        training.sizes.table_decay.value = 1e-5;
        for (steps, expected) in [
            (0, 1e-5),
            (250, 5.625e-6),
            (500, 2.5e-6),
            (1_000, 0.0),
            (u64::MAX, 0.0),
        ] {
            let found = f64::from(training.table_decay_at(steps));
            assert!((found - expected).abs() < 1e-12, "{steps}: {found}");
        }
    }

    #[test]
    fn samples_are_chosen_once_the_steps_along_rays_were_halved() {
        let mut training = of(None);
        for (halvings, asked, chosen) in [(0, 32, 0), (1, 32, 32), (3, 32, 32), (1, 0, 0)] {
            training.state.halvings = halvings;
            training.config.ray_samples = asked;
            assert_eq!(training.ray_samples(), chosen);
        }
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
