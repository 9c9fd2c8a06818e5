//! Training on what rover photos bring: changing exposure and sparse points.

use crate::test_scene::{ball, ball_view, small, trained};
use crate::{Config, FieldError, Gain, Trainer};

#[test]
fn gains_follow_the_exposure_and_keep_a_mean_of_zero() {
    let mut views = ball(6, 16);
    for pixel in views[0].image.pixels.as_flattened_mut() {
        *pixel = (f32::from(*pixel) * 0.7) as u8;
    }
    let config = Config {
        learning_rate: 2e-2,
        batch_samples: 4096,
        ..small()
    };
    let trainer = trained(views.clone(), &config, 4, 400);
    for channel in 0..3 {
        let gains: Vec<f32> = trainer
            .training
            .state
            .gains
            .iter()
            .skip(channel)
            .step_by(4)
            .copied()
            .collect();
        let mean = gains.iter().sum::<f32>() / 6.0;
        assert!(mean.abs() < 1e-5, "channel {channel}: {gains:?}");
        assert!(
            gains[0] < -0.02 && gains[1..].iter().all(|gain| *gain > gains[0] + 0.02),
            "{channel}: {gains:?}"
        );
    }
    let off = Config {
        gain: Gain::Off,
        ..config
    };
    assert!(
        trained(views, &off, 4, 10)
            .training
            .state
            .gains
            .iter()
            .all(|gain| *gain == 0.0)
    );
}

#[test]
fn offsets_follow_what_a_gain_cannot_and_keep_a_mean_of_zero() {
    let mut views = ball(6, 16);
    for pixel in views[0].image.pixels.as_flattened_mut() {
        *pixel = pixel.saturating_add(30);
    }
    let config = Config {
        batch_samples: 4096,
        gain: Gain::PerPhotoAndOffset,
        ..small()
    };
    let trainer = trained(views, &config, 4, 400);
    let (gains, offsets) = trainer.training.state.gains.split_at(24);
    for channel in 0..3 {
        for numbers in [gains, offsets] {
            let sum: f32 = numbers.iter().skip(channel).step_by(4).sum();
            assert!(sum.abs() < 1e-5, "channel {channel}: {numbers:?}");
        }
    }
    // A grey of 0.5 is shown 30 / 255 * 5 / 6 brighter than the mean photo shows it.
    let shown = |view: usize| gains[view * 4].exp().mul_add(0.5, offsets[view * 4]);
    assert!(
        shown(0) > 0.54 && (1..6).all(|view| shown(view) < 0.52),
        "{gains:?} {offsets:?}"
    );
}

#[test]
fn a_black_photo_and_a_single_photo_leave_exposures_finite_and_bounded() {
    let mut views = ball(4, 8);
    views[1].image.pixels.fill([0; 3]);
    for gain in [Gain::PerPhoto, Gain::PerPhotoAndOffset] {
        for count in [1, 4] {
            let config = Config {
                learning_rate: 0.5,
                gain,
                ..small()
            };
            let trainer = trained(views[..count].to_vec(), &config, 4, 100);
            // Cut at 2, then moved by a mean of 2 at most.
            let bounded = trainer
                .training
                .state
                .gains
                .iter()
                .all(|number| number.abs() <= 4.0);
            assert!(
                bounded,
                "{gain:?}, {count} photos: {:?}",
                trainer.training.state.gains
            );
            assert!(count > 1 || trainer.training.state.gains.iter().all(|number| *number == 0.0));
        }
    }
}

/// Points on the ball of `shade`, which all views see from outside.
fn coat() -> Vec<[f64; 3]> {
    let angles = (0..200).map(|index| f64::from(index) * 2.399_963);
    let heights = (0..200).map(|index| (f64::from(index) + 0.5) / 100.0 - 1.0);
    angles
        .zip(heights)
        .map(|(angle, z)| {
            let radius = (1.0 - z * z).sqrt();
            [radius * angle.cos(), radius * angle.sin(), z]
        })
        .collect()
}

#[test]
fn sparse_points_make_the_ball_opaque_sooner_and_leave_no_trace_where_they_are_off() {
    let pulled = Config {
        batch_samples: 4096,
        depth_weight: 3e-3,
        depth_steps: Some(200),
        ..small()
    };
    let plain = Config {
        depth_weight: 0.0,
        ..pulled.clone()
    };
    let middle = |config: &Config| {
        let mut trainer = Trainer::new(ball(12, 24), &coat(), config, 3).unwrap();
        for _ in 0..100 {
            trainer.advance(1).unwrap();
        }
        let view = ball_view(0.4, 0.3, 24);
        let render = trainer
            .field()
            .unwrap()
            .render(&view.camera, &view.cam_from_world)
            .unwrap();
        (render.opacity[12 * 24 + 12], render.depth[12 * 24 + 12])
    };
    let (with, without) = (middle(&pulled), middle(&plain));
    // The ball is about 2 away. Matter within 2.5 steps of 0.2 counts as being at its points.
    let there = with.0 > without.0 + 0.1 && (1.4..2.7).contains(&with.1);
    assert!(there, "{with:?} {without:?}");
    // No points: nothing pulls.
    let states = [&pulled, &plain].map(|config| trained(ball(3, 12), config, 3, 20).training.state);
    assert!(states[0] == states[1]);
}

#[test]
fn a_resumed_training_with_points_gives_the_same_bytes_and_refuses_other_points() {
    let config = Config {
        depth_weight: 3e-3,
        depth_steps: Some(30),
        ..small()
    };
    let fresh = |points: &[[f64; 3]]| Trainer::new(ball(4, 16), points, &config, 7).unwrap();
    let run = |mut trainer: Trainer, steps: u32| {
        for _ in 0..steps {
            trainer.advance(1).unwrap();
        }
        trainer
    };
    let half = run(fresh(&coat()), 21).save().unwrap();
    let mut resumed = fresh(&coat());
    resumed.restore(&half).unwrap();
    assert!(run(resumed, 19).save().unwrap() == run(fresh(&coat()), 40).save().unwrap());
    let what = "photos, cameras or box";
    let mut points = coat();
    points[7][2] *= 0.9;
    assert_eq!(
        fresh(&points).restore(&half),
        Err(FieldError::OtherTraining { what })
    );
}
