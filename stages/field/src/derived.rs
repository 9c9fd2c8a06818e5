use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::frame::{ENOUGH_POINTS, Frame, box_of};
use crate::{Config, FieldError, Sizes, View};

/// What a training derived from its scene: the box, and the sizes of the field in it.
///
/// Another training of the same scene that is begun with it ([`Trainer::with_derived`](crate::Trainer::with_derived)) has the
/// same box and sizes, whichever photos it learns from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Derived {
    /// Centre of the box, world units.
    pub origin: [f64; 3],
    /// Half side of the inner box, world units.
    pub half_side: f64,
    /// Typical distance from a camera to what it sees, world units.
    pub depth: f64,
    /// Why this box.
    pub box_reason: String,
    /// Near, far, finest level, levels, table and halvings, each with its reason.
    pub sizes: Sizes,
}

impl Derived {
    /// Returns a box and sizes as what was derived.
    pub(crate) fn new(frame: &Frame, sizes: &Sizes) -> Self {
        Self {
            origin: frame.origin,
            half_side: frame.half_side,
            depth: frame.depth,
            box_reason: frame.reason.clone(),
            sizes: sizes.clone(),
        }
    }

    /// Returns the box.
    pub(crate) fn frame(&self) -> Frame {
        Frame {
            origin: self.origin,
            half_side: self.half_side,
            depth: self.depth,
            reason: self.box_reason.clone(),
        }
    }

    /// Checks that a training on these views can use it.
    ///
    /// # Errors
    /// [`FieldError::OutOfBox`] if the box is invalid or a camera has no place in it. A size out of its
    /// range.
    pub(crate) fn check(&self, config: &Config, views: &[View]) -> Result<(), FieldError> {
        self.frame().check(views)?;
        self.sizes.check(config)
    }

    /// Returns how far a scene reaches from the middle of this box, half sides of it. 1 if its own box would
    /// be inside this one.
    ///
    /// `points`: its sparse points. With fewer than 32 the cameras decide: those `before`, and all `now`,
    /// world units. The reach of those before then counts as 1, if they are not in the box.
    pub fn reach(&self, points: &[[f64; 3]], before: &[Vector3<f64>], now: &[Vector3<f64>]) -> f64 {
        let from_middle = |at: [f64; 3]| {
            let away = [0, 1, 2].map(|axis| (at[axis] - self.origin[axis]).abs() / self.half_side);
            away.into_iter().fold(0.0, f64::max)
        };
        if points.len() >= ENOUGH_POINTS {
            let (origin, half_side) = box_of(points);
            return from_middle(origin) + half_side / self.half_side;
        }
        let farthest = |cameras: &[Vector3<f64>]| {
            let away = cameras.iter().map(|camera| from_middle((*camera).into()));
            away.fold(1.0, f64::max)
        };
        farthest(now) / farthest(before)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, small};
    use crate::training::Training;
    use crate::{PixelDistance, Trainer};

    /// Lengths of a box that was fitted are rounded to f32 twice, those of one that was given once.
    const ROUNDED: f32 = 2.0 * f32::EPSILON;

    fn derived() -> Derived {
        let mut trainer = Trainer::new(ball(6, 12), &[], &small(), 0).unwrap();
        trainer.field().unwrap().derived()
    }

    #[test]
    fn a_training_of_fewer_photos_has_the_box_and_sizes_it_is_given() {
        let derived = derived();
        let fewer = || ball(6, 12).split_off(3);
        let mut own = Trainer::new(fewer(), &[], &small(), 0).unwrap();
        assert_ne!(own.field().unwrap().derived(), derived);
        let mut given = Trainer::with_derived(fewer(), &[], &small(), 7, &derived).unwrap();
        given.advance(1).unwrap();
        assert_eq!(given.field().unwrap().derived(), derived);
        assert_eq!(given.training.refit_step, None);
    }

    #[test]
    fn points_and_distances_pull_to_the_same_places_in_a_box_that_was_fitted() {
        let mut views = ball(6, 16);
        for view in &mut views {
            let distance = |column, distance| PixelDistance {
                pixel: [column, 8],
                distance,
                sigma: 0.01 * distance,
            };
            view.distances = vec![distance(7, 2.1), distance(8, 3.0)];
        }
        let sparse = [[0.0, 0.0, 0.5]];
        let mut training = Training::new(views.clone(), &sparse, &small(), 0).unwrap();
        let at_first = training.frame.half_side;
        let matter = (0..64).map(|index| {
            let angle = 0.1 * f64::from(index);
            [angle.cos(), angle.sin(), 0.5 * (2.0 * angle).sin()]
        });
        assert!(training.refit(&matter.collect::<Vec<_>>()));
        assert!(training.frame.half_side < 0.5 * at_first, "{at_first}");
        let derived = Derived::new(&training.frame, &training.sizes);
        let given = Training::with_derived(views, &sparse, &small(), 0, &derived).unwrap();
        let [found, expected] = [&training, &given].map(|training| training.observations.clone());
        assert_eq!((found.len(), expected.len()), (6 * 3, 6 * 3));
        for (found, expected) in found.iter().zip(&expected) {
            assert_eq!(found.pixel, expected.pixel);
            for (found, expected) in [(found.t, expected.t), (found.sigma, expected.sigma)] {
                let off = (found - expected).abs();
                assert!(off <= ROUNDED * expected, "{found} instead of {expected}");
            }
        }
        // A restored training is placed in its own box again.
        let (frame, sizes, state) = (
            training.frame.clone(),
            training.sizes.clone(),
            training.state.clone(),
        );
        training.place(frame, sizes, state);
        assert_eq!(training.observations, found);
    }

    #[test]
    fn places_of_distances_decide_the_box_where_sparse_points_are_too_few() {
        let mut views = ball(6, 16);
        for view in &mut views {
            let distances = (0..16).map(|row| PixelDistance {
                pixel: [7, row],
                distance: if row < 4 { f32::INFINITY } else { 2.0 },
                sigma: 0.0,
            });
            view.distances = distances.collect();
        }
        let shown = |view: &View| {
            view.distances
                .iter()
                .filter_map(|one| view.place_of(one))
                .collect::<Vec<_>>()
        };
        let places: Vec<[f64; 3]> = views.iter().flat_map(shown).collect();
        assert_eq!(places.len(), 6 * 12);
        for (place, view) in places.iter().step_by(12).zip(&views) {
            let away = (Vector3::from(*place) - view.cam_from_world.centre()).norm();
            assert!((away - 2.0).abs() < 1e-12, "{away}");
            assert_eq!(view.pixel_of(&Vector3::from(*place)), Some([7, 4]));
        }
        let by_distances = Training::new(views.clone(), &[], &small(), 0).unwrap();
        // They lie closely, and say nothing of how well photos overlap.
        let decay = &by_distances.sizes.table_decay.reason;
        assert!(decay.contains("0 sparse points"), "{decay}");
        // One photo of six says too little.
        for view in &mut views[1..] {
            view.distances.clear();
        }
        let by_axes = Training::new(views, &[], &small(), 0).unwrap();
        assert_eq!(
            by_axes.frame,
            Training::new(ball(6, 16), &[], &small(), 0).unwrap().frame
        );
        let by_points = Training::new(ball(6, 16), &places, &small(), 0).unwrap();
        assert_eq!(by_distances.sizes.near, by_points.sizes.near);
        let [found, expected] = [by_distances, by_points].map(|training| training.frame);
        assert_eq!(
            (found.origin, found.half_side),
            (expected.origin, expected.half_side)
        );
        let said =
            "pairs of photos show distances, whose places count as sparse points: 80 % of 72 sparse points";
        assert!(found.reason.starts_with(said), "{}", found.reason);
    }

    #[test]
    fn a_box_or_a_size_that_cannot_be_used_is_refused() {
        let refused = |change: fn(&mut Derived)| {
            let mut derived = derived();
            change(&mut derived);
            Trainer::with_derived(ball(6, 12), &[], &small(), 0, &derived).is_err()
        };
        assert!(!refused(|_| ()));
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut derived = derived();
            derived.half_side = bad;
            let trainer = Trainer::with_derived(ball(6, 12), &[], &small(), 0, &derived);
            assert!(trainer.is_err(), "half side {bad}");
        }
        assert!(refused(|derived| derived.origin[1] = f64::NAN));
        assert!(refused(|derived| derived.sizes.near.value = 0.0));
        assert!(refused(|derived| derived.sizes.log2_table.value = 40));
        assert!(refused(|derived| derived.sizes.halvings.value = 7));
    }
}
