//! What changes with the steps of a training: step size, averaging, rays of a batch, length of the steps along rays.

use crate::depth::SHARE;
use crate::schedule::STEPS_A_HALVING;
use crate::training::Training;

/// Share of the training after which the steps along rays are halved for the last time, the other times in
/// equal parts before. Long steps find a surface sooner, short ones place it better.
const LAST_HALVED: f64 = 0.9;
/// Steps for which the rate stays at least: a training of 400 steps lost .6 dB where it fell from the start.
const RATE_HELD: u64 = 512;
/// Step size of a training that starts from a field, as a share of that of one from nothing. Moments are
/// zero, so its first steps move every weight by about the whole of it. `benches/field.md`.
const WARM_RATE: f64 = 0.5;
/// With fewer samples a ray than this the steps are halved at once. Checked every [`FEW_AT`] steps.
const FEW_SAMPLES: f64 = 8.0;
const FEW_AT: u64 = 128;
/// Samples a chunk of rays aims at: its rows then stay in the second cache.
const CHUNK_SAMPLES: f64 = 768.0;
/// Steps between two updates of the averaged weights: every step costs a pass over all tables.
const AVERAGED_EVERY: u64 = 4;

impl Training {
    /// Returns the step size after a number of steps: `learning_rate` for half of the training and at least
    /// 512 steps, then down by equal factors to `final_rate` of it at the end, where it stays. After a new
    /// plan it is that of a training with this plan from the start and the same share done, to whole steps.
    /// From a field it is half of that, and never held for 512 steps.
    pub fn rate_at(&self, steps: u64) -> f32 {
        let (done, end) = (self.schedule.done(steps), self.schedule.end_at(steps));
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

    /// Returns the share of themselves that the averaged weights keep after a number of steps, less in the
    /// first ones.
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

    /// Returns the weight of a pull in a step of `rays` rays. `None` where no point pulls, or no longer.
    pub fn pull_at(&self, step: u64, rays: usize) -> Option<f32> {
        let fading = 1.0 - step as f64 / f64::from(self.sizes.depth_steps.value);
        let weight = self.config.depth_weight * fading * SHARE as f64 / rays as f64;
        (!self.observations.is_empty() && fading > 0.0).then_some(weight as f32)
    }

    /// Returns the weight of the distortion loss after a number of steps.
    pub fn distortion_at(&self, steps: u64) -> f32 {
        let [first, last] = self.sizes.distortion.value;
        let done = self.schedule.done(steps);
        ((last - first) * done).mul_add(done, first) as f32
    }

    /// Returns the pull of the tables to zero after a number of steps.
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

    /// Returns how often the steps along rays are halved by then, without the halvings for few samples. From
    /// a field: as often as in the field, or more if there are steps for it, but from the start again. Long
    /// steps give more rays for as many samples, which new photos need.
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

    /// Returns how many samples of a ray are trained in the next step, about. 0: all that show.
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
    use crate::Config;
    use crate::test_scene::{ball, small};

    fn training(steps: Option<u64>) -> Training {
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
            let training = training(Some(steps));
            let shares = [0, steps / 2, steps, u64::MAX]
                .map(|step| f64::from(training.rate_at(step)) / training.config.learning_rate);
            for (share, expected) in shares.into_iter().zip([1.0, 1.0, last, last]) {
                assert!((share / expected - 1.0).abs() < 1e-6, "{steps}: {shares:?}");
            }
        }
        // Unknown: as 4,000 steps.
        assert_eq!(
            training(None).rate_at(3_210),
            training(Some(4_000)).rate_at(3_210)
        );
    }

    #[test]
    fn steps_along_rays_are_halved_in_equal_parts_of_nine_tenths_of_the_training() {
        for (steps, expected) in [(3_000, [900, 1_800, 2_700]), (100_000, [30_000, 60_000, 90_000])] {
            let mut training = training(Some(steps));
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

    /// In 1,000 steps all four halvings are made again, in equal parts of nine tenths. 10,000 are enough for
    /// all six.
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
            let mut training = training(Some(steps));
            (training.halved_before, training.sizes.halvings.value) = (Some(before), 6);
            for (at, halvings) in expected {
                assert_eq!(training.halvings_due(at), halvings, "{before}, {steps}: {at}");
            }
        }
    }

    #[test]
    fn from_a_field_half_the_rate_falls_in_the_second_half_however_short() {
        let mut training = training(Some(400));
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
            let mut training = training(Some(steps));
            training.state.samples_per_ray = 100.0;
            training.state.steps = at;
            training.halve_steps();
            assert_eq!(training.state.halvings, halvings, "{steps}, {at}");
        }
    }

    #[test]
    fn rays_with_few_samples_have_their_steps_halved_at_once() {
        let mut training = training(Some(100_000));
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
        let mut training = training(Some(1_000));
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
        let mut training = training(Some(1_000));
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
        let mut training = training(None);
        for (halvings, asked, chosen) in [(0, 32, 0), (1, 32, 32), (3, 32, 32), (1, 0, 0)] {
            training.state.halvings = halvings;
            training.config.ray_samples = asked;
            assert_eq!(training.ray_samples(), chosen);
        }
    }
}
