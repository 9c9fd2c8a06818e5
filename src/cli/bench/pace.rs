//! The pace of a device, measured before a training by the clock: its batch and its steps follow.

use std::time::Instant;

use marf_engine::Cancel;
use marf_field::{Config, Device, FieldError, OpenSizes, Pilot, Trainer, View, steps_in};

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
        let failed = |error: FieldError| Error::failed(error.to_string());
        let new_trainer = |config: &Config| {
            let trainer = Trainer::new(views.to_vec(), self.points, config, self.seed);
            trainer
                .and_then(|trainer| trainer.with_backend(marf_field_gpu::open(self.device)?))
                .map_err(failed)
        };
        let first = new_trainer(config)?;
        let begun = Instant::now();
        let pilot = Pilot {
            seconds,
            open: if self.has_batch {
                OpenSizes::Table
            } else {
                OpenSizes::BatchAndTable
            },
            new_trainer: &new_trainer,
            left_s: &|| seconds - begun.elapsed().as_secs_f64(),
            check: &|| {
                if self.cancel.is_set() {
                    return Err(Error::Interrupted);
                }
                Ok(())
            },
            failed,
        };
        let (trainer, pace) = pilot.run(first, config)?;
        let used_s = begun.elapsed().as_secs_f64();
        let steps = steps_in(seconds - used_s, pace.steps);
        let config = Config {
            steps: Some(steps),
            batch_samples: trainer.batch_samples(),
            ..config.clone()
        };
        Ok((config, used_s))
    }
}
