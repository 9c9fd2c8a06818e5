//! Sizes that follow from what a device does in a second: how many samples a step has, and with the steps the table.

use std::time::Instant;

use crate::{Config, FieldError, Trainer};

/// Steps that two cores take in a second, to choose the table that a pace is measured with first.
pub const EXPECTED_STEPS_PER_S: f64 = 90.0;
/// Samples a step of such a machine: those of [`Config::default`](crate::Config).
const COMMON_BATCH: u32 = 1 << 15;
/// Fewest and most samples of a step that are derived. With 2^18 instant-ngp trains at 30 M samples/s and
/// more (arXiv 2201.05989, appendix E). With fewer than 2^12 the occupancy and the tables take most of a
/// step.
const BATCHES: [u32; 2] = [1 << 12, 1 << 18];
/// Part of the time of a training, and most seconds, for which its rate is measured before sizes are chosen.
const MEASURED_SHARE: f64 = 1.0 / 16.0;
const MEASURED_MOST_S: f64 = 3.0;

/// What a training does in a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Optimiser steps.
    pub steps: f64,
    /// Rays.
    pub rays: f64,
    /// Samples that were trained.
    pub samples: f64,
}

impl Pace {
    /// Changes of a batch by [`Trainer::suit`] after which its pace is measured again, at most: a larger one is faster by itself,
    /// as a step has costs of its own.
    const MOST_CHANGES: usize = 2;

    /// Returns the seconds for which the pace of a training of `seconds` is measured.
    fn measured_s(seconds: f64) -> f64 {
        (seconds * MEASURED_SHARE).min(MEASURED_MOST_S)
    }

    /// Tables that a pace is measured with after the first, at most, in trainings of
    /// `SETTLED_FROM_S` or more. Each takes two seconds.
    const MOST_TABLES: usize = 2;
    const SETTLED_FROM_S: f64 = 120.0;

    /// Returns a trainer with the table that `seconds` fill, and its pace. A larger table makes a step slower, so the pace is measured
    /// again until the table is the one that it was measured with.
    ///
    /// `steps_of` returns the steps that there is time for at a pace. `measured` makes a trainer for a number of steps and measures it. A
    /// GPU keeps its first table, and so does a short training.
    ///
    /// # Errors
    /// Those of `measured`.
    fn settled<E>(
        mut self,
        mut trainer: Trainer,
        seconds: f64,
        steps_of: impl Fn(&Self) -> u64,
        measured: impl Fn(u64) -> Result<(Trainer, Self), E>,
    ) -> Result<(Trainer, Self), E> {
        if trainer.backend.id().is_some() || seconds < Self::SETTLED_FROM_S {
            return Ok((trainer, self));
        }
        for _ in 0..Self::MOST_TABLES {
            let steps = steps_of(&self);
            if trainer.has_table_of(steps) {
                break;
            }
            drop(trainer);
            (trainer, self) = measured(steps)?;
        }
        Ok((trainer, self))
    }

    /// Returns the samples of a step that suit a device of this pace, a power of two from 2^12 to 2^18.
    ///
    /// The device's excess over two cores, which train 90 steps of 2^15 samples a second, is split evenly, in
    /// octaves: half into samples a step, half into steps. B = 2^15 √(samples a second / 2.95 M), the nearest
    /// power of two. Samples alone do not replace steps: below about 2^15 a gradient is noisy and a step
    /// mostly overhead. Beyond 2^18 more samples a step were not worth their time to instant-ngp, whose batch
    /// that is (arXiv 2201.05989, appendix E).
    ///
    /// # Extremes
    /// A pace that is NaN, negative or 0 gives the fewest samples, an infinite one the most.
    pub fn batch_samples(&self) -> u32 {
        let common = EXPECTED_STEPS_PER_S * f64::from(COMMON_BATCH);
        let [least, most] = BATCHES.map(|batch| f64::from(batch.ilog2()));
        let octaves = 0.5 * (self.samples / common).max(0.0).log2();
        let log2 = f64::from(COMMON_BATCH.ilog2()) + octaves;
        // The first is taken where the second is NaN.
        1 << least.max(log2.round()).min(most) as u32
    }
}

/// Returns the steps that a time is for, at least one.
pub fn steps_in(seconds: f64, steps_per_s: f64) -> u64 {
    ((seconds * steps_per_s) as u64).max(1)
}

/// Sizes of a training that the pace of its device decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OpenSizes {
    /// None: another training has decided them.
    Nothing,
    /// The table.
    Table,
    /// The table and the samples of a step.
    BatchAndTable,
}

/// A short training that measures the pace of a device before a training by the clock, and settles the sizes that follow from it.
pub struct Pilot<'a, E> {
    /// Seconds of the training by the clock.
    pub seconds: f64,
    /// Sizes that it settles.
    pub open: OpenSizes,
    /// Returns a trainer at step 0.
    pub new_trainer: &'a dyn Fn(&Config) -> Result<Trainer, E>,
    /// Returns the seconds that are left for steps.
    pub left_s: &'a dyn Fn() -> f64,
    /// Returns an error if the training is to stop.
    pub check: &'a dyn Fn() -> Result<(), E>,
    /// Returns the error of a field as the caller's.
    pub failed: fn(FieldError) -> E,
}

impl<E> Pilot<'_, E> {
    /// Trains `first`, made with `config`, and returns a trainer with settled sizes and its pace.
    ///
    /// # Errors
    /// Those of a training, of `new_trainer` and of `check`.
    pub fn run(&self, first: Trainer, config: &Config) -> Result<(Trainer, Pace), E> {
        let half_s = Pace::measured_s(self.seconds) / 2.0;
        let mut first = first;
        self.train_for(&mut first, half_s)?;
        let mut pace = self.train_for(&mut first, half_s)?;
        if self.open == OpenSizes::BatchAndTable {
            for _ in 0..Pace::MOST_CHANGES {
                if !first.suit(&pace).map_err(self.failed)? {
                    break;
                }
                pace = self.train_for(&mut first, half_s)?;
            }
        }
        if self.open == OpenSizes::Nothing {
            return Ok((first, pace));
        }
        let measured = |steps: u64| {
            let mut trainer = (self.new_trainer)(&Config {
                steps: Some(steps),
                ..config.clone()
            })?;
            let pace = self.train_for(&mut trainer, half_s)?;
            Ok::<_, E>((trainer, pace))
        };
        let steps_of = |pace: &Pace| steps_in((self.left_s)(), pace.steps);
        pace.settled(first, self.seconds, steps_of, measured)
    }

    /// Trains for a time, at least one step, and returns the pace.
    fn train_for(&self, trainer: &mut Trainer, seconds: f64) -> Result<Pace, E> {
        let (began, before) = (Instant::now(), trainer.steps());
        // A slow device may need longer for sixteen steps, which a GPU takes at once, than the time is.
        let (mut rays, mut samples, mut most) = (0, 0, 1_u64);
        loop {
            (self.check)()?;
            let step = trainer.advance(most).map_err(self.failed)?;
            (rays, samples, most) = (rays + step.rays, samples + step.samples, most.saturating_mul(2));
            if began.elapsed().as_secs_f64() >= seconds {
                let last = trainer.settle().map_err(self.failed)?;
                (rays, samples) = (rays + last.rays, samples + last.samples);
                let elapsed_s = began.elapsed().as_secs_f64();
                let [steps, rays, samples] =
                    [trainer.steps() - before, rays, samples].map(|count| count as f64 / elapsed_s);
                return Ok(Pace { steps, rays, samples });
            }
        }
    }
}

impl Trainer {
    /// Takes over the batch that suits the device at this pace, and returns whether that is another one: then the pace is, too.
    ///
    /// A CPU keeps the batch that it has, and so does a device that refuses the other.
    ///
    /// # Errors
    /// A device that failed.
    pub fn suit(&mut self, pace: &Pace) -> Result<bool, FieldError> {
        let wanted = pace.batch_samples();
        if self.backend.id().is_none() || wanted == self.batch_samples() {
            return Ok(false);
        }
        self.aim_at(wanted)
    }

    /// Returns whether a training of this many steps has a table as large as this one.
    fn has_table_of(&self, steps: u64) -> bool {
        let training = &self.training;
        training.sizes.log2_table_after(&training.config, steps) == training.sizes.log2_table.value
    }

    /// Changes the samples that a step aims at, and returns whether the device can hold them. The learnt
    /// state stays.
    fn aim_at(&mut self, samples: u32) -> Result<bool, FieldError> {
        self.sync()?;
        let before = std::mem::replace(&mut self.training.config.batch_samples, samples);
        match self.backend.clone().begin(&mut self.training) {
            Ok(session) => {
                self.session = session;
                Ok(true)
            }
            Err(error) if error.is_too_large() => {
                self.training.config.batch_samples = before;
                Ok(false)
            }
            Err(error) => Err(error),
        }
    }

    /// Returns the samples that a step aims at.
    pub fn batch_samples(&self) -> u32 {
        self.training.config.batch_samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::size;
    use crate::test_scene::{ball, small};

    fn at_rate(samples: f64) -> Pace {
        Pace {
            steps: 1.0,
            rays: 1.0,
            samples,
        }
    }

    #[test]
    fn a_batch_grows_with_the_root_of_the_rate_between_its_ends() {
        for (samples, log2) in [
            (f64::NAN, 12),
            (-1.0, 12),
            (0.0, 12),
            (5e4, 12),
            (2e5, 13),
            (1.2e6, 14),
            (2.95e6, 15),
            (5.8e6, 15),
            (6e6, 16),
            (34e6, 17),
            (100e6, 18),
            (1e12, 18),
            (f64::INFINITY, 18),
        ] {
            assert_eq!(at_rate(samples).batch_samples(), 1 << log2, "{samples} a second");
        }
    }

    /// 100 M samples a second fill 2^19 entries in 10 s and 2^20 in 60 s, the 2.95 M of two cores 2^15 and 2^17.
    #[test]
    fn a_card_gets_the_tables_of_a_card() {
        let table = |samples: f64, seconds: f64| {
            let batch_samples = at_rate(samples).batch_samples();
            let config = Config {
                batch_samples,
                steps: Some((seconds * samples / f64::from(batch_samples)) as u64),
                ..Config::default()
            };
            size::Sizes::most(&config).log2_table.value
        };
        assert_eq!([table(2.95e6, 10.0), table(2.95e6, 60.0)], [15, 17]);
        assert_eq!([table(100e6, 10.0), table(100e6, 60.0)], [19, 20]);
    }

    #[test]
    fn a_pilot_takes_a_sixteenth_of_the_time_and_no_more_than_three_seconds() {
        assert_eq!([8.0, 48.0, 1e9].map(Pace::measured_s), [0.5, 3.0, 3.0]);
    }

    /// The steps of the first row are what rover4 took in 300 s on two cores of a Xeon with tables of 2^17, 2^18 and 2^19.
    #[test]
    fn a_pace_is_that_of_the_table_which_its_steps_fill() {
        let with = |log2: u32| {
            let mut trainer = Trainer::new(ball(2, 8), &[], &small(), 1).unwrap();
            trainer.training.config = Config::default();
            let sizes = &mut trainer.training.sizes;
            sizes.surface_cells.value = 1 << 40;
            (sizes.detail.value, sizes.log2_table.value) = (1.0, log2);
            trainer
        };
        for (seconds, steps, first, asked, last) in [
            (300.0, [18_600, 13_578, 8_100], 19, vec![8_100, 18_600], 18),
            (119.9, [18_600, 13_578, 8_100], 19, vec![], 19),
            (300.0, [18_600, 13_578, 8_100], 18, vec![], 18),
            (300.0, [18_600, 13_578, 8_100], 17, vec![18_600], 18),
            (120.0, [18_600, 8_100, 8_100], 17, vec![18_600, 8_100], 17),
            (f64::INFINITY, [u64::MAX, u64::MAX, u64::MAX], 22, vec![], 22),
        ] {
            let pace = |log2: u32| Pace {
                steps: steps[log2.clamp(17, 19) as usize - 17] as f64,
                ..at_rate(1.0)
            };
            let measured_for = std::cell::RefCell::new(Vec::new());
            let measured = |steps: u64| {
                measured_for.borrow_mut().push(steps);
                let log2 = with(12)
                    .training
                    .sizes
                    .log2_table_after(&Config::default(), steps);
                Ok::<_, FieldError>((with(log2), pace(log2)))
            };
            let settled = pace(first).settled(with(first), seconds, |pace| pace.steps as u64, measured);
            let (trainer, found) = settled.unwrap();
            assert_eq!(measured_for.into_inner(), asked, "{steps:?} from {first}");
            assert_eq!(
                trainer.training.sizes.log2_table.value, last,
                "{steps:?} from {first}"
            );
            assert_eq!(found, pace(last), "{steps:?} from {first}");
        }
    }

    #[test]
    fn a_time_is_for_whole_steps_and_at_least_one() {
        assert_eq!(steps_in(60.0, 12.34), 740);
        assert_eq!(steps_in(0.001, 12.0), 1);
        assert_eq!([steps_in(60.0, f64::NAN), steps_in(-1.0, 9.0)], [1, 1]);
    }

    #[test]
    fn a_cpu_keeps_its_batch_at_any_pace() {
        let mut trainer = Trainer::new(ball(2, 8), &[], &small(), 1).unwrap();
        assert_eq!(trainer.suit(&at_rate(1e9)), Ok(false));
        assert_eq!(trainer.batch_samples(), small().batch_samples);
    }
}
