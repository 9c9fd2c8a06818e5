//! What judging a field costs, foreseen at the beginning of a training by the clock.

use marf_field::{STEPS_A_HALVING, steps_in};

use crate::{TrainError, scoring::JudgedPhotos};

/// Samples of a training that take as long as a ray of a render before any halving: 1.2 on lego, 2.5 on the fox, 3.3 on the mock-up.
const SAMPLES_A_RAY: f64 = 3.0;
/// Factor by which a render takes longer where steps along rays are half as long: 1.12 on the fox, 1.26 on lego, 1.3 on the mock-up, means
/// of three halvings (`benches/time.md`).
const LONGER: f64 = 1.25;
/// Share of a wait that is kept for judging where all photos would take longer.
pub(crate) const JUDGED_SHARE: f64 = 0.25;

/// Seconds and photos that judging a field takes.
pub(crate) struct JudgingCost {
    /// Seconds of a photo before any halving of the steps along rays.
    pub unhalved_s: f64,
    /// Halvings that the field begins with.
    pub first_halvings: u32,
    /// Halvings that it has at most.
    pub most_halvings: u32,
    /// Photos held out.
    pub held_out: usize,
    /// Photos trained on.
    pub seen: usize,
}

impl JudgingCost {
    /// Returns the seconds of a photo of `rays` rays before any halving, for a training of `samples_per_s`.
    pub fn unhalved_s(rays: f64, samples_per_s: f64) -> f64 {
        rays * SAMPLES_A_RAY / samples_per_s
    }

    /// Returns the seconds of a photo after this number of halvings.
    fn photo_s(&self, halvings: u32) -> f64 {
        self.unhalved_s * slower(halvings)
    }

    /// Returns the seconds of all photos after `steps`, including those trained on.
    pub fn all_s(&self, steps: u64) -> f64 {
        let reached = self.most_halvings.min((steps / STEPS_A_HALVING) as u32);
        let halvings = self.first_halvings.max(reached);
        self.photo_s(halvings) * (self.held_out + self.seen) as f64
    }

    /// Returns the most steps that fit into the `left_s` seconds that remain of a wait of `wait_s`, at `steps_per_s`. Also returns the
    /// seconds of the judging after them.
    ///
    /// # Errors
    /// [`TrainError::NoTime`] if judging alone takes longer.
    pub fn most_steps(&self, wait_s: f64, left_s: f64, steps_per_s: f64) -> Result<(u64, f64), TrainError> {
        let kept = |halvings: u32| kept_s(self.photo_s(halvings), self.held_out, wait_s);
        if left_s <= kept(0) {
            return Err(TrainError::NoTime {
                within_s: wait_s,
                left_s,
                judging_s: kept(0),
            });
        }
        Ok(most_steps(left_s, steps_per_s, self.most_halvings, kept))
    }
}

/// Returns how much slower a render is after this number of halvings.
pub(crate) fn slower(halvings: u32) -> f64 {
    LONGER.powi(halvings as i32)
}

/// Returns the seconds of a wait that are kept for judging photos at `photo_s` each. They are for all photos, or for as many as their share
/// of the wait allows, but for a few at least.
pub(super) fn kept_s(photo_s: f64, photos: usize, wait_s: f64) -> f64 {
    let all_s = |photos: usize| photo_s * photos as f64;
    all_s(photos).min((JUDGED_SHARE * wait_s).max(all_s(JudgedPhotos::LEAST)))
}

/// Returns the most steps that, with the judging after them, fit into a time, and the seconds of that judging. Every halving of the steps
/// along rays, after [`STEPS_A_HALVING`] steps each, makes judging slower.
fn most_steps(
    left_s: f64,
    steps_per_s: f64,
    most_halvings: u32,
    judging_s: impl Fn(u32) -> f64,
) -> (u64, f64) {
    let with_halvings = |halvings: u32| {
        let steps = steps_in(left_s - judging_s(halvings), steps_per_s);
        let before_next = STEPS_A_HALVING * (u64::from(halvings) + 1) - 1;
        let steps = if halvings < most_halvings {
            steps.min(before_next)
        } else {
            steps
        };
        (steps, judging_s(halvings))
    };
    let more = (1..=most_halvings).map(with_halvings);
    more.fold(
        with_halvings(0),
        |best, next| if next.0 > best.0 { next } else { best },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 100 steps a second and 60 s, judging 5 s and twice as long with each halving. 3,840 steps have six halvings of 640 steps, which
    /// judging forbids. After three halvings judging takes 40 s and leaves 2,000 steps. After two it takes 20 s, but the third comes at
    /// step 1,920.
    #[test]
    fn judging_that_becomes_slower_with_the_steps_leaves_as_many_as_fit() {
        let judging = |halvings: u32| 5.0 * 2_f64.powi(halvings as i32);
        assert_eq!(most_steps(60.0, 100.0, 6, judging), (2_000, 40.0));
        assert_eq!(most_steps(50.0, 100.0, 6, judging), (1_919, 20.0));
        assert_eq!(most_steps(60.0, 100.0, 0, judging), (5_500, 5.0));
        assert_eq!(most_steps(60.0, 100.0, 1, |_| 0.0), (6_000, 0.0));
        assert_eq!(most_steps(1.0, 100.0, 6, judging).0, 1, "no time is left");
    }

    /// 24 photos of 1 s each, a quarter longer with each halving, after 640 steps each and four times at most. A warm start begins with
    /// three.
    #[test]
    fn judging_becomes_slower_with_the_halvings_of_a_field() {
        let judging = |first: u32| JudgingCost {
            unhalved_s: 1.0,
            first_halvings: first,
            most_halvings: 4,
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
        assert_eq!(cold.most_steps(8.0, 5.0, 100.0).unwrap(), (100, 4.0));
        assert!(matches!(
            cold.most_steps(8.0, 4.0, 100.0),
            Err(TrainError::NoTime { judging_s, .. }) if judging_s == 4.0
        ));
    }

    /// Of 60 s a quarter is for judging. It fits 12 photos of 1 s. It fits three of 5 s, but at least four are judged. Of two photos both
    /// are judged.
    #[test]
    fn judging_has_its_share_of_a_wait() {
        assert_eq!(kept_s(1.0, 12, 60.0), 12.0);
        assert_eq!(kept_s(2.0, 12, 60.0), 15.0);
        assert_eq!(kept_s(5.0, 12, 60.0), 20.0);
        assert_eq!(kept_s(5.0, 2, 60.0), 10.0);
    }
}
