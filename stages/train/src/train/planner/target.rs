//! A quality at which a training stops, looked on training photos that are held back.

use std::ops::Range;

use marf_field::{Field, Schedule};
use marf_schema::train::{Forecast, Target};
use marf_stage::{Ctx, StageError};
use serde::{Deserialize, Serialize};

use crate::{
    photos::{PhotoReader, ScaledPhoto},
    scoring::mean_psnr,
    split::{NamedFrame, spread},
};

/// The first look, in steps, and looks for every doubling of the steps. At most a sixth is trained beyond the target.
const FIRST: f64 = 256.0;
const A_DOUBLING: f64 = 4.0;
/// Photos of a look, at most. If these have the target, all are looked at.
const PHOTOS: usize = 12;
/// Longest side in pixels of the thinned photos of a small look, which costs little. A whole look has all pixels of the training.
const SIDE_PX: u32 = 64;
/// A whole look follows where the small one, less the difference of the last two, misses the target by no more than this, dB.
const NEAR_DB: f64 = 0.1;
/// Share of the training after which its end is predicted, from the looks of the last two doublings.
const PREDICTED_FROM: f64 = 0.125;
/// Least miss of the target by a forecast that is reported, dB.
const CLEAR_DB: f64 = 0.5;

/// A target, and the photos that it is looked on.
pub(crate) struct PsnrTarget<'a> {
    pub psnr: f64,
    photos: &'a PhotoReader<'a>,
    validation: Vec<NamedFrame<'a>>,
    small: Vec<(NamedFrame<'a>, ScaledPhoto)>,
}

/// How far a field was from its target at every look. Part of a checkpoint.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct TargetLooks {
    /// Steps and PSNR of the small looks.
    looks: Vec<(u64, f64)>,
    /// By how much the last whole look was less than the small one, dB. 0 before the first whole look.
    whole_less: f64,
    forecast: Option<Forecast>,
    /// Steps after which all photos held back had the target, and their PSNR.
    reached: Option<(u64, f64)>,
}

impl<'a> PsnrTarget<'a> {
    /// Reads the photos of small looks.
    pub fn new(
        psnr: f64,
        photos: &'a PhotoReader<'a>,
        at_once: usize,
        validation: &[NamedFrame<'a>],
    ) -> Result<Self, StageError> {
        let some: Vec<_> = spread(validation.len(), PHOTOS)
            .map(|index| validation[index].clone())
            .collect();
        let thinned = photos.map(&some, at_once, |_, photo: ScaledPhoto| photo.thinned_to(SIDE_PX))?;
        Ok(Self {
            psnr,
            photos,
            validation: validation.to_vec(),
            small: some.into_iter().zip(thinned).collect(),
        })
    }

    /// Returns whether the field is to be looked at after these steps: at the end, too.
    pub fn is_due(&self, taken: &Range<u64>, end: u64) -> bool {
        looks_due(taken.end) > looks_due(taken.start) || taken.end >= end
    }

    /// Compares the field after `steps` with the target and returns whether it has it.
    ///
    /// # Errors
    /// Those of a render.
    pub fn look(
        &self,
        ctx: &Ctx<'_>,
        looked: &mut TargetLooks,
        field: &Field,
        schedule: &Schedule,
        steps: u64,
    ) -> Result<bool, StageError> {
        let small = mean_psnr(ctx, field, &self.small)?;
        looked.looks.push((steps, small));
        if small - looked.whole_less + NEAR_DB >= self.psnr {
            let whole = self.whole(ctx, field)?;
            looked.whole_less = small - whole;
            if whole >= self.psnr {
                looked.reached = Some((steps, whole));
                return Ok(true);
            }
        }
        if schedule.done(steps) >= PREDICTED_FROM {
            looked.predict(steps, schedule.end_at(steps), self.psnr);
        }
        Ok(false)
    }

    /// Returns how far the field at the end, after `steps`, is from the target.
    ///
    /// # Errors
    /// Those of a render.
    pub fn report(
        &self,
        ctx: &Ctx<'_>,
        looked: &TargetLooks,
        field: &Field,
        steps: u64,
    ) -> Result<Target, StageError> {
        let (reached_at, validation_psnr) = match looked.reached {
            Some((steps, psnr)) => (Some(steps), psnr),
            None => {
                let psnr = self.mean(ctx, field, 0..self.validation.len())?;
                ((psnr >= self.psnr).then_some(steps), psnr)
            }
        };
        Ok(Target {
            psnr: self.psnr,
            reached_at,
            validation_psnr,
            validation_photos: self.validation.len() as u64,
            forecast: looked.forecast,
        })
    }

    /// Compares the field with [`PHOTOS`] of the photos held back, and with all where these have the target.
    fn whole(&self, ctx: &Ctx<'_>, field: &Field) -> Result<f64, StageError> {
        let count = self.validation.len();
        let some = self.mean(ctx, field, spread(count, PHOTOS))?;
        if some >= self.psnr && count > PHOTOS {
            return self.mean(ctx, field, 0..count);
        }
        Ok(some)
    }

    /// Compares the field with some of the photos held back, one at a time.
    fn mean(
        &self,
        ctx: &Ctx<'_>,
        field: &Field,
        some: impl ExactSizeIterator<Item = usize>,
    ) -> Result<f64, StageError> {
        let count = some.len();
        let mut sum = 0.0;
        for index in some {
            let named = &self.validation[index];
            let photo = self.photos.read(named.frame)?;
            sum += mean_psnr(ctx, field, &[(named.clone(), photo)])?;
        }
        Ok(sum / count as f64)
    }
}

impl TargetLooks {
    /// Predicts the PSNR at the end, and keeps the first forecast that misses the target.
    fn predict(&mut self, steps: u64, end: u64, target: f64) {
        let psnr = predicted_psnr(&self.looks, end).map(|small| small - self.whole_less);
        if let Some(psnr) = psnr.filter(|psnr| psnr + CLEAR_DB < target && self.forecast.is_none()) {
            self.forecast = Some(Forecast { at: steps, psnr });
        }
    }

    /// Returns the note on the target, which precedes the loss in the progress.
    pub fn note(&self, target: f64) -> String {
        match (&self.forecast, self.looks.last()) {
            (Some(forecast), _) => {
                let psnr = forecast.psnr;
                format!("target {target} dB out of reach (about {psnr:.1} dB at the end), ")
            }
            (None, Some((_, psnr))) => format!("target {target} dB ({psnr:.1} dB at a small look), "),
            (None, None) => String::new(),
        }
    }
}

/// Returns how many looks are due by then.
fn looks_due(steps: u64) -> u64 {
    if (steps as f64) < FIRST {
        return 0;
    }
    (libm::log2(steps as f64 / FIRST) * A_DOUBLING) as u64 + 1
}

/// Returns the PSNR at the end if it grows with the logarithm of the steps as over the last two doublings. A curve that flattens reaches at
/// most this. `None` before there are two doublings.
fn predicted_psnr(looks: &[(u64, f64)], end: u64) -> Option<f64> {
    let (steps, psnr) = *looks.last()?;
    let (before, psnr_before) = *looks.iter().rev().find(|(at, _)| at.saturating_mul(4) <= steps)?;
    let doublings = |from: u64, to: u64| libm::log2(to.max(from) as f64 / from as f64);
    let slope = (psnr - psnr_before) / doublings(before, steps);
    Some(psnr + slope.max(0.0) * doublings(steps, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_are_due_four_times_a_doubling_from_256_steps_on() {
        let due: Vec<u64> = (1..=1_024)
            .filter(|steps| looks_due(*steps) > looks_due(steps - 1))
            .collect();
        assert_eq!(due, [256, 305, 363, 431, 512, 609, 725, 862, 1_024]);
        assert_eq!([looks_due(0), looks_due(255)], [0, 0]);
        assert!(looks_due(u64::MAX) < 1_000);
    }

    /// 20 dB after 256 steps and 22 dB after 1,024: one dB a doubling, so that 4,096 steps give 24 dB.
    #[test]
    fn the_end_is_predicted_by_the_last_two_doublings() {
        let looks = [(64, 12.0), (256, 20.0), (512, 21.5), (1_024, 22.0)];
        assert!((predicted_psnr(&looks, 4_096).unwrap() - 24.0).abs() < 1e-12);
        assert_eq!(predicted_psnr(&looks, 900), Some(22.0), "the end is behind");
        assert_eq!(
            predicted_psnr(&[(64, 9.0), (256, 8.0)], 10_000),
            Some(8.0),
            "it does not grow"
        );
        assert_eq!(predicted_psnr(&looks[..1], 4_096), None);
        assert_eq!(predicted_psnr(&[], 1), None);
        let mut looked = TargetLooks {
            looks: looks.to_vec(),
            whole_less: 1.0,
            ..TargetLooks::default()
        };
        looked.predict(1_024, 4_096, 23.4);
        assert_eq!(looked.forecast, None, "23 dB are not clearly less");
        looked.predict(1_024, 4_096, 23.6);
        assert_eq!(looked.forecast.map(|forecast| forecast.at), Some(1_024));
        assert!(
            looked.note(23.6).contains("about 23.0 dB at the end"),
            "{}",
            looked.note(23.6)
        );
    }
}
