//! What a training by the clock is foreseen to take: the steps that a time is for, and the judging after them.

use std::time::Instant;

use marf_field::{Pace, STEPS_A_HALVING, Trainer};
use marf_scene::Camera;
use marf_stage::{Ctx, StageError};

use super::Plan;
use crate::{
    TrainError,
    photos::PhotoReader,
    scoring::{Chosen, mean_psnr},
};

/// Samples of a training that take as long as a ray of a render before any halving: 1.2 on lego, 2.5 on the fox, 3.3 on the mock-up.
const SAMPLES_A_RAY: f64 = 3.0;
/// By how much longer a render takes where steps along rays are half as long: 1.12 on the fox, 1.26 on lego, 1.3 on the mock-up, means of
/// three halvings (`benches/time.md`).
const LONGER: f64 = 1.25;
/// Longest side of the photos that judging is measured on, pixels.
const MEASURED_SIDE_PX: u32 = 96;
/// Share of a wait that is kept for judging where all photos would take longer.
pub(super) const JUDGED_SHARE: f64 = 0.25;

/// What judging is foreseen to take.
pub(super) struct Judging {
    /// Seconds of a photo before any halving of the steps along rays.
    unhalved_s: f64,
    /// Halvings that the field begins with, and at most has.
    halvings: [u32; 2],
    /// Photos: held out, and trained on.
    pub held_out: usize,
    seen: usize,
}

impl Judging {
    /// Foresees it at the rates of a training that has just begun.
    pub fn foreseen(plan: &Plan<'_>, trainer: &Trainer, rates: &Pace) -> Self {
        let (held_out, seen) = plan.judged_photos();
        let field = plan.start.field.as_ref();
        Self {
            unhalved_s: plan.photo_rays() * SAMPLES_A_RAY / rates.samples,
            halvings: [
                field.map_or(0, |field| field.facts().halvings),
                trainer.most_halvings(),
            ],
            held_out,
            seen,
        }
    }

    /// Returns the seconds of a photo after so many halvings.
    fn photo_s(&self, halvings: u32) -> f64 {
        self.unhalved_s * LONGER.powi(halvings as i32)
    }

    /// Returns the seconds of all photos, those trained on too, after so many steps.
    pub fn all_s(&self, steps: u64) -> f64 {
        let [first, most] = self.halvings;
        let halvings = first.max(most.min((steps / STEPS_A_HALVING) as u32));
        self.photo_s(halvings) * (self.held_out + self.seen) as f64
    }

    /// Returns the most steps that fit into what is left of a wait, at so many a second, and the seconds of the judging after them.
    pub fn most_steps(&self, wait_s: f64, (left_s, rate): (f64, f64)) -> Result<(u64, f64), TrainError> {
        let kept = |halvings: u32| kept_s(self.photo_s(halvings), self.held_out, wait_s);
        if left_s <= kept(0) {
            return Err(TrainError::NoTime {
                within_s: wait_s,
                left_s,
                judging_s: kept(0),
            });
        }
        Ok(most_steps((left_s, rate), self.halvings[1], kept))
    }
}

impl Plan<'_> {
    /// Returns how many photos the field may be judged by: held out, and trained on.
    fn judged_photos(&self) -> (usize, usize) {
        let held_out = self.split.held_out.len();
        let most = self.judging.chosen.most.unwrap_or(held_out);
        (held_out.min(most), self.seen().map_or(0, |seen| seen.len()))
    }

    /// Returns the rays of a photo that the field will be judged by.
    fn photo_rays(&self) -> f64 {
        let camera = self.split.held_out[0]
            .frame
            .camera
            .box_reduced(self.judging.scale);
        f64::from(camera.width) * f64::from(camera.height)
    }

    /// Returns the seconds that judging a photo will take, as the held-out photos take now when they are small, and will take at
    /// their size with the shorter steps of the end.
    pub fn photo_s(
        &self,
        ctx: &Ctx<'_>,
        photos: &PhotoReader<'_>,
        trainer: &mut Trainer,
    ) -> Result<f64, StageError> {
        let held_out = &self.split.held_out;
        let photos = &photos.at(self.scene, self.judging.scale);
        let both = photos.map(held_out, self.memory.at_once, |_, photo| {
            (photo.camera, photo.thinned_to(MEASURED_SIDE_PX))
        })?;
        let rays = |camera: &Camera| f64::from(camera.width) * f64::from(camera.height);
        let whole: f64 = both.iter().map(|(camera, _)| rays(camera)).sum();
        let small: f64 = both.iter().map(|(_, small)| rays(&small.camera)).sum();
        let small_photos = both.into_iter().map(|(_, small)| small);
        let pairs: Vec<_> = held_out.iter().cloned().zip(small_photos).collect();
        let field = trainer.field().map_err(TrainError::from)?;
        let begun = Instant::now();
        mean_psnr(ctx, &field, &pairs)?;
        let slower = LONGER.powi(trainer.halvings_left() as i32);
        Ok(begun.elapsed().as_secs_f64() * whole / small * slower / held_out.len() as f64)
    }
}

/// Returns the steps that a time is for, at least one.
pub(super) fn steps_in(seconds: f64, steps_per_second: f64) -> u64 {
    ((seconds * steps_per_second) as u64).max(1)
}

/// Returns the seconds of a wait that are kept for judging photos, one of which takes `photo_s`: for all, or for as many as its share
/// of the wait allows, but for a few at least.
pub(super) fn kept_s(photo_s: f64, photos: usize, wait_s: f64) -> f64 {
    let of = |photos: usize| photo_s * photos as f64;
    of(photos).min((JUDGED_SHARE * wait_s).max(of(Chosen::LEAST)))
}

/// Returns the most steps that, with the judging after them, fit into a time, and the seconds of that judging: every halving of the
/// steps along rays, after [`STEPS_A_HALVING`] steps each, lets judging take longer.
fn most_steps((left_s, rate): (f64, f64), most: u32, judging: impl Fn(u32) -> f64) -> (u64, f64) {
    let of = |halvings: u32| {
        let steps = steps_in(left_s - judging(halvings), rate);
        let before_next = STEPS_A_HALVING * (u64::from(halvings) + 1) - 1;
        let steps = if halvings < most {
            steps.min(before_next)
        } else {
            steps
        };
        (steps, judging(halvings))
    };
    (1..=most)
        .map(of)
        .fold(of(0), |best, next| if next.0 > best.0 { next } else { best })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_for_whole_steps_and_at_least_one() {
        assert_eq!(steps_in(60.0, 12.34), 740);
        assert_eq!(steps_in(0.001, 12.0), 1);
        assert_eq!([steps_in(60.0, f64::NAN), steps_in(-1.0, 9.0)], [1, 1]);
    }

    /// 100 steps a second and 60 s, judging 5 s and twice as long with each halving: 3,840 steps have six halvings of 640 steps,
    /// which judging forbids; after three it takes 40 s and leaves 2,000 steps, after two 20 s, and the third comes at step 1,920.
    #[test]
    fn judging_that_becomes_slower_with_the_steps_leaves_as_many_as_fit() {
        let judging = |halvings: u32| 5.0 * 2_f64.powi(halvings as i32);
        assert_eq!(most_steps((60.0, 100.0), 6, judging), (2_000, 40.0));
        assert_eq!(most_steps((50.0, 100.0), 6, judging), (1_919, 20.0));
        assert_eq!(most_steps((60.0, 100.0), 0, judging), (5_500, 5.0));
        assert_eq!(most_steps((60.0, 100.0), 1, |_| 0.0), (6_000, 0.0));
        assert_eq!(most_steps((1.0, 100.0), 6, judging).0, 1, "no time is left");
    }

    /// 24 photos of a second each: a quarter longer with each halving, after 640 steps each and not more than four; a warm start begins with three.
    #[test]
    fn judging_becomes_slower_with_the_halvings_of_a_field() {
        let judging = |first: u32| Judging {
            unhalved_s: 1.0,
            halvings: [first, 4],
            held_out: 12,
            seen: 12,
        };
        let cold = judging(0);
        assert_eq!(
            [639, 640, 1_280].map(|steps| cold.all_s(steps)),
            [24.0, 30.0, 37.5]
        );
        assert_eq!(cold.all_s(100_000), cold.all_s(2_560));
        assert_eq!(judging(3).all_s(1), cold.all_s(1_920));
        // Four photos at least are judged, in 4 s.
        assert_eq!(cold.most_steps(8.0, (5.0, 100.0)).unwrap(), (100, 4.0));
        assert!(matches!(
            cold.most_steps(8.0, (4.0, 100.0)),
            Err(TrainError::NoTime { judging_s, .. }) if judging_s == 4.0
        ));
    }

    /// Of 60 s a quarter is for judging: 12 photos of 1 s fit it, of 5 s three would, and four are judged; two are all there are.
    #[test]
    fn judging_has_its_share_of_a_wait() {
        assert_eq!(kept_s(1.0, 12, 60.0), 12.0);
        assert_eq!(kept_s(2.0, 12, 60.0), 15.0);
        assert_eq!(kept_s(5.0, 12, 60.0), 20.0);
        assert_eq!(kept_s(5.0, 2, 60.0), 10.0);
    }
}
