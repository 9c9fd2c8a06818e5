//! A training that starts from a field.

use std::collections::BTreeSet;

use crate::exposure::{LIMITS, ROW, StartExposure, centre, centred};
use crate::training::Training;
use crate::{Field, FieldError, PhotoHistory};

impl Training {
    /// Returns the exposure of a photo, empty where all share one.
    pub fn exposure(&self, view: usize) -> Vec<f32> {
        let half = self.views.len() * ROW;
        let rows = self.state.gains.chunks(half.max(1));
        match self.config.gain {
            crate::Gain::Off => Vec::new(),
            _ => rows
                .flat_map(|rows| &rows[view * ROW..][..ROW])
                .copied()
                .collect(),
        }
    }

    /// Gives the photos their first exposures, one for each view, where photos have gains and offsets of their own.
    pub fn start_exposures(&mut self, exposures: Vec<StartExposure>) {
        if self.config.gain != crate::Gain::PerPhotoAndOffset {
            return;
        }
        let (gains, offsets) = self.state.gains.split_at_mut(self.views.len() * ROW);
        let rows = gains.chunks_exact_mut(ROW).zip(offsets.chunks_exact_mut(ROW));
        for ((gain, offset), exposure) in rows.zip(centred(exposures)) {
            gain[..3].copy_from_slice(&exposure.log_gain);
            offset[..3].copy_from_slice(&exposure.offset);
        }
        for (numbers, limit) in [gains, offsets].into_iter().zip(LIMITS) {
            centre(numbers, limit);
        }
    }

    /// Takes over weights, exposures and occupancy of a field of the same box and sizes, at step 0.
    ///
    /// Cells that only photos see which it was not trained on start occupied, all others as the field has them.
    ///
    /// # Errors
    /// A field of other sizes.
    pub fn start_from(&mut self, field: &Field) -> Result<(), FieldError> {
        let model = &field.model;
        let is_same = self.state.weights.shapes == model.weights.shapes
            && self.state.weights.features == model.weights.features
            && lengths(&self.state.weights) == lengths(&model.weights)
            && self.config.occupancy_resolution == model.config.occupancy_resolution;
        if !is_same {
            return Err(FieldError::OtherTraining { what: "size" });
        }
        let state = &mut self.state;
        state.weights = model.weights.clone();
        state.average = model.weights.clone();
        self.halved_before = Some(model.facts.halvings);
        let known: BTreeSet<&str> = field
            .learnt()
            .into_iter()
            .flat_map(|learnt| &learnt.photos)
            .map(|photo| photo.id.as_str())
            .collect();
        let old = self.views.iter().filter(|view| known.contains(view.id.as_str()));
        state.occupancy = state
            .occupancy
            .known(&model.bits, &self.frame, &old.cloned().collect::<Vec<_>>());
        self.take_exposures(field.learnt());
        self.state.halvings = self.halvings_due(0);
        self.march = self.sizes.steps(&self.config, self.state.halvings);
        self.state.samples_per_ray = self.march.count as f64;
        Ok(())
    }

    /// Takes over the exposures of the photos that the field was trained on. New ones start neutral.
    fn take_exposures(&mut self, learnt: Option<&PhotoHistory>) {
        let half = self.views.len() * ROW;
        for (view, photo) in self.views.iter().enumerate() {
            let Some(known) = learnt.and_then(|learnt| learnt.photo(&photo.id)) else {
                continue;
            };
            let rows = self.state.gains.chunks_mut(half.max(1));
            for (rows, numbers) in rows.zip(known.exposure.chunks(ROW)) {
                rows[view * ROW..][..ROW].copy_from_slice(numbers);
            }
        }
    }
}

fn lengths(weights: &crate::weights::Weights) -> Vec<usize> {
    let tensors = weights.tensors();
    tensors.iter().map(|(_, values)| values.len()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, psnr, small, trained};
    use nalgebra::Vector3;

    use crate::{Config, Trainer, View};

    /// The bits of all weights.
    fn bits(weights: &crate::weights::Weights) -> Vec<u32> {
        let tensors = weights.tensors();
        tensors
            .iter()
            .flat_map(|(_, values)| *values)
            .map(|value| value.to_bits())
            .collect()
    }

    /// A field of the even views of a ring of eight, after `steps` steps, and all eight.
    fn begun(steps: u32) -> (Field, Vec<View>) {
        let views = ball(8, 16);
        let even = views.iter().step_by(2).cloned().collect();
        let mut trainer = trained(even, &small(), 3, steps);
        let learnt = trainer.learnt(None).unwrap();
        (trainer.field().unwrap().with_learnt(learnt), views)
    }

    fn from(field: &Field, views: Vec<View>, config: &Config) -> Result<Trainer, FieldError> {
        Trainer::from_field(views, &[], config, 3, field)
    }

    #[test]
    fn at_step_0_weights_box_and_sizes_are_those_of_the_field() {
        let (field, views) = begun(160);
        let mut warm = from(&field, views, &small()).unwrap();
        assert_eq!((warm.steps(), warm.training.refit_step), (0, None));
        let state = &warm.training.state;
        for weights in [&state.weights, &state.average] {
            assert_eq!(bits(weights), bits(&field.model.weights));
        }
        assert!(
            state
                .moments
                .iter()
                .all(|moments| moments.first.iter().all(|first| *first == 0.0))
        );
        assert_eq!(warm.training.halved_before, Some(field.facts().halvings));
        let now = warm.field().unwrap();
        assert_eq!(now.derived(), field.derived());
    }

    /// The same photos: cells are as the field has them. One photo that it does not know: only cells that it alone sees are added.
    #[test]
    fn cells_that_only_new_photos_see_start_occupied() {
        let (field, views) = begun(160);
        let even = || views.iter().step_by(2).cloned();
        let bits = |views: Vec<View>| {
            from(&field, views, &small())
                .unwrap()
                .training
                .state
                .occupancy
                .bits
        };
        assert_eq!(bits(even().collect()), field.model.bits);
        assert!(field.model.bits.share() < 0.5, "{}", field.model.bits.share());
        // From above, where no photo of the ring looks.
        let above = View {
            id: "above".to_owned(),
            ..crate::test_scene::ball_view(0.3, 9.0, 16)
        };
        let more = bits(even().chain([above]).collect());
        assert!(more.share() > field.model.bits.share());
        let kept = field
            .model
            .bits
            .words
            .iter()
            .zip(&more.words)
            .all(|(was, is)| was & !is == 0);
        assert!(kept, "a cell of the field is lost");
    }

    #[test]
    fn exposures_go_with_their_photos_and_new_ones_are_neutral() {
        for gain in [crate::Gain::PerPhoto, crate::Gain::PerPhotoAndOffset] {
            let config = Config { gain, ..small() };
            let views = ball(4, 12);
            let mut trainer = trained(views[..3].to_vec(), &config, 0, 8);
            let learnt = trainer.learnt(Some(1.0)).unwrap();
            let field = trainer.field().unwrap().with_learnt(learnt.clone());
            // In another order, with a new photo between.
            let order = [2, 3, 0, 1].map(|index: usize| views[index].clone());
            let warm = from(&field, order.to_vec(), &config).unwrap();
            for (view, photo) in order.iter().enumerate() {
                let found = warm.training.exposure(view);
                match learnt.photo(&photo.id) {
                    Some(known) => assert_eq!(found, known.exposure, "{}", photo.id),
                    None => assert!(found.iter().all(|number| *number == 0.0), "{found:?}"),
                }
            }
            assert!(learnt.photos[0].exposure.iter().any(|number| *number != 0.0));
        }
    }

    #[test]
    fn it_goes_on_from_where_the_field_is() {
        let (field, views) = begun(160);
        let after_steps = |mut trainer: Trainer| {
            for _ in 0..8 {
                trainer.advance(1).unwrap();
            }
            psnr(&trainer.field().unwrap(), &views[0])
        };
        let cold = after_steps(Trainer::new(views.clone(), &[], &small(), 3).unwrap());
        let warm = after_steps(from(&field, views.clone(), &small()).unwrap());
        assert!(warm > cold + 2.0, "{warm} dB, from nothing {cold} dB");
    }

    #[test]
    fn a_field_of_other_sizes_is_refused() {
        let (field, views) = begun(0);
        for other in [
            Config {
                density_width: 32,
                ..small()
            },
            Config {
                occupancy_resolution: 16,
                ..small()
            },
            Config {
                view_dependence: crate::ViewDependence::Off,
                ..small()
            },
        ] {
            let refused = from(&field, views.clone(), &other);
            assert!(
                matches!(refused, Err(FieldError::OtherTraining { .. })),
                "{other:?}"
            );
        }
    }

    #[test]
    fn what_it_tells_of_its_photos_survives_and_without_it_the_bytes_are_as_before() {
        let (field, _) = begun(1);
        let bytes = field.encode();
        let read = Field::decode(&bytes).unwrap();
        assert_eq!((read.learnt(), read.encode()), (field.learnt(), bytes));
        let mut silent = field.clone();
        silent.model.learnt = None;
        assert!(!String::from_utf8_lossy(&silent.encode()).contains("learnt"));
        let (photos, few) = (
            &field.learnt().unwrap().photos,
            |range: std::ops::Range<usize>| PhotoHistory {
                metres_per_unit: None,
                photos: field.learnt().unwrap().photos[range].to_vec(),
            },
        );
        assert_eq!(&few(1..3).and(&few(0..2)).photos, &photos[..3]);
    }

    /// A box of half side 2 around (1, 0, 0).
    #[test]
    fn a_scene_reaches_as_far_as_its_own_box_or_its_new_cameras() {
        let mut derived = Trainer::new(ball(4, 8), &[], &small(), 0)
            .unwrap()
            .field()
            .unwrap()
            .derived();
        (derived.origin, derived.half_side) = ([1.0, 0.0, 0.0], 2.0);
        let at = |x: f64| Vector3::new(x, 0.0, 0.0);
        let points: Vec<[f64; 3]> = (0..101)
            .map(|index| [2.0 + f64::from(index) / 50.0, 0.0, 0.0])
            .collect();
        // Their median is 3, and 80 % are within 0.8.
        let reach = derived.reach(&points, &[at(1.0)], &[at(99.0)]);
        assert!((reach - (1.0 + 0.4)).abs() < 0.011, "{reach}");
        let cameras =
            |before: f64, now: f64| derived.reach(&points[..9], &[at(before)], &[at(before), at(now)]);
        assert_eq!(
            [
                cameras(2.0, 2.5),
                cameras(2.0, 5.0),
                cameras(5.0, 9.0),
                cameras(9.0, 5.0)
            ],
            [1.0, 2.0, 2.0, 1.0]
        );
    }
}
