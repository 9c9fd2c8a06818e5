//! Trainings with settings from the whole range of every key. Each ends in finite numbers or in an error that
//! names the tensor, and never in a state that cannot be restored.

use proptest::prelude::*;

use crate::test_scene::{ball, ball_view, small};
use crate::{Background, Config, FieldError, Gain, Trainer, ViewDependence};

/// Optimiser steps of a case: three updates of the occupancy, and the box is fitted after the second.
const STEPS: u64 = 36;

/// Equal factors between the two ends.
fn log(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low.ln()..=high.ln()).prop_map(move |place| place.exp().clamp(low, high))
}

prop_compose! {
    fn sizes()(
        (levels, features) in prop::sample::select(vec![(4, 4), (8, 2), (8, 4), (16, 2), (16, 4)]),
        log2_table in 8..=14_u32,
        base_resolution in 4..=64_u32,
        finest_resolution in prop::option::of(64..=8192_u32),
        density_width in prop::sample::select(vec![16, 32, 64, 128]),
        color_width in prop::sample::select(vec![16, 32, 64, 128]),
        color_layers in 1..=3_u32,
        occupancy_resolution in prop::sample::select(vec![16, 32]),
    ) -> Config {
        Config {
            levels: Some(levels), features, log2_table: Some(log2_table), base_resolution, finest_resolution,
            density_width, color_width, color_layers, occupancy_resolution, ..small()
        }
    }
}

prop_compose! {
    fn rates()(
        sizes in sizes(),
        learning_rate in log(1e-6, 1.0),
        final_rate in log(1e-4, 1.0),
        average in 0.0..=0.9999,
        batch_samples in 256..=2048_u32,
        ray_samples in prop::sample::select(vec![0, 1, 32, 4096]),
        steps in prop::option::of(prop::sample::select(vec![1, 36, 100_000, u64::MAX])),
        halvings in prop::option::of(0..=6_u32),
        refit_steps in prop::sample::select(vec![0, 32]),
    ) -> Config {
        Config {
            learning_rate, final_rate, average, batch_samples, ray_samples, steps, halvings, refit_steps: Some(refit_steps), ..sizes
        }
    }
}

prop_compose! {
    fn configs()(
        rates in rates(),
        cone in log(1.0 / 256.0, 0.25),
        min_step in log(1e-3, 0.5),
        distortion in prop::sample::select(vec![None, Some(0.0), Some(1e-3), Some(1.0)]),
        table_decay in prop::sample::select(vec![None, Some(0.0), Some(1.0)]),
        emptiness in prop::sample::select(vec![0.0, 3e-5, 0.1]),
        depth_weight in prop::sample::select(vec![0.0, 3e-3, 1.0]),
        gain in prop::sample::select(vec![Gain::Off, Gain::PerPhoto, Gain::PerPhotoAndOffset]),
        background in prop::sample::select(vec![Background::Direction, Background::Black]),
        view_dependence in prop::sample::select(vec![ViewDependence::On, ViewDependence::Off]),
    ) -> Config {
        Config {
            cone, min_step, distortion, table_decay, emptiness, depth_weight, gain, background, view_dependence, ..rates
        }
    }
}

/// Points on the ball, or none.
fn points(count: u32) -> Vec<[f64; 3]> {
    let angle = |index: u32| f64::from(index) * 2.4;
    let height = |index: u32| 1.0 - 2.0 * (f64::from(index) + 0.5) / f64::from(count);
    let point = |index: u32| {
        let across = (1.0 - height(index).powi(2)).sqrt();
        [
            across * angle(index).cos(),
            across * angle(index).sin(),
            height(index),
        ]
    };
    (0..count).map(point).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn any_settings_train_to_finite_numbers_or_stop_by_name(
        config in configs(),
        count in prop::sample::select(vec![0_u32, 40]),
        seed: u64,
    ) {
        config.check().unwrap();
        let mut trainer = Trainer::new(ball(3, 8), &points(count), &config, seed).unwrap();
        // From here on samples are chosen.
        trainer.training.state.halvings = trainer.training.sizes.halvings.value.min(1);
        for step in 0..STEPS {
            let before = trainer.save().unwrap();
            match trainer.advance(1) {
                Ok(progress) => prop_assert!(progress.loss.is_finite(), "step {step}: {progress:?}"),
                Err(FieldError::NotFinite { .. }) => {
                    prop_assert!(config.learning_rate > 0.05, "step {step} at {}", config.learning_rate);
                    prop_assert!(trainer.save().unwrap() == before, "step {step} changed what it could not go on from");
                    break;
                }
                Err(error) => prop_assert!(false, "step {step}: {error}"),
            }
        }
        let bytes = trainer.save().unwrap();
        let mut again = Trainer::new(ball(3, 8), &points(count), &config, seed).unwrap();
        again.restore(&bytes).unwrap();
        prop_assert!(again.save().unwrap() == bytes);
        let view = ball_view(0.3, 0.2, 6);
        let render = trainer.field().unwrap().render(&view.camera, &view.cam_from_world).unwrap();
        let colours = render.rgb.as_flattened();
        prop_assert!(colours.iter().all(|value| (0.0..=1.0).contains(value)), "{colours:?}");
    }
}
