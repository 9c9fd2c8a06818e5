//! The pace of a device, measured before a training by the clock: its batch and its steps follow.

use std::time::Instant;

use marf_engine::Cancel;
use marf_field::{Config, Device, Pace, Trainer, View};

use marf_run::Error;

/// A training whose size follows the pace of its device.
#[derive(Clone, Copy)]
pub struct Paced<'a> {
    pub device: &'a Device,
    pub cancel: &'a Cancel,
    pub points: &'a [[f64; 3]],
    pub seed: u64,
    /// Whether a key says the samples of a step.
    pub has_batch: bool,
}

impl Paced<'_> {
    /// Trains for a part of so many seconds; returns the configuration for the rest of them, and how many seconds it took.
    ///
    /// # Errors
    /// As those of trainings; the wish to stop.
    pub fn config(self, views: &[View], config: &Config, seconds: f64) -> Result<(Config, f64), Error> {
        let failed = |error: marf_field::FieldError| Error::failed(error.to_string());
        let new = |config: &Config| {
            let trainer = Trainer::new(views.to_vec(), self.points, config, self.seed);
            trainer
                .and_then(|trainer| trainer.on(self.device))
                .map_err(failed)
        };
        let mut trainer = new(config)?;
        let begun = Instant::now();
        let half_s = Pace::measured_s(seconds) / 2.0;
        self.train_for(&mut trainer, half_s)?;
        let mut pace = self.train_for(&mut trainer, half_s)?;
        for _ in 0..Pace::MOST_CHANGES {
            if self.has_batch || !trainer.suit(&pace).map_err(failed)? {
                break;
            }
            pace = self.train_for(&mut trainer, half_s)?;
        }
        let steps_of = |pace: &Pace| (pace.steps * (seconds - begun.elapsed().as_secs_f64())).max(1.0) as u64;
        let measured = |steps: u64| {
            let steps = Some(steps);
            let mut trainer = new(&Config {
                steps,
                ..config.clone()
            })?;
            let pace = self.train_for(&mut trainer, half_s)?;
            Ok::<_, Error>((trainer, pace))
        };
        let (trainer, pace) = pace.settled(trainer, seconds, steps_of, measured)?;
        let (used_s, steps) = (begun.elapsed().as_secs_f64(), steps_of(&pace));
        let config = Config {
            steps: Some(steps),
            batch_samples: trainer.batch_samples(),
            ..config.clone()
        };
        Ok((config, used_s))
    }

    /// Trains for a time, at least one step.
    fn train_for(self, trainer: &mut Trainer, seconds: f64) -> Result<Pace, Error> {
        let (begun, before) = (Instant::now(), trainer.steps());
        // A slow device may need longer for sixteen steps, which a GPU takes at once, than the time is.
        let (mut rays, mut samples, mut most) = (0, 0, 1_u64);
        loop {
            if self.cancel.is_set() {
                return Err(Error::Interrupted);
            }
            let failed = |error: marf_field::FieldError| Error::failed(error.to_string());
            let step = trainer.advance(most).map_err(failed)?;
            (rays, samples, most) = (rays + step.rays, samples + step.samples, most.saturating_mul(2));
            if begun.elapsed().as_secs_f64() >= seconds {
                let last = trainer.settle().map_err(failed)?;
                (rays, samples) = (rays + last.rays, samples + last.samples);
                let elapsed_s = begun.elapsed().as_secs_f64();
                let [steps, rays, samples] =
                    [trainer.steps() - before, rays, samples].map(|count| count as f64 / elapsed_s);
                return Ok(Pace { steps, rays, samples });
            }
        }
    }
}
