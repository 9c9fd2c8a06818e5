//! Training as a whole: equal bytes, resumption, learning, refusals, degenerate photos.

use std::sync::Arc;

use marf_scene::{Camera, Image, Pose};
use nalgebra::Vector3;

use crate::cpu::simd::InstructionSet;
use crate::cpu_backend::Cpu;
use crate::test_scene::{ball, ball_view, psnr, small, trained};
use crate::training::Training;
use crate::{Background, Config, Field, FieldError, Pixels, Trainer, View, ViewDependence};

#[test]
fn a_patterned_ball_is_learnt_to_25_db_on_a_held_out_view() {
    let config = Config {
        batch_samples: 8192,
        density_width: 32,
        log2_table: Some(13),
        cone: 0.04,
        min_step: 0.02,
        ..small()
    };
    let mut trainer = trained(ball(24, 40), &config, 1, 800);
    let field = trainer.field().unwrap();
    let held_out = ball_view(0.4, 0.3, 40);
    let score = psnr(&field, &held_out);
    assert!(score > 25.0, "{score} dB, {:?}", field.facts());
    let render = field.render(&held_out.camera, &held_out.cam_from_world).unwrap();
    // The middle pixel looks at the ball, about 2 units away, the corner at the sky.
    let (middle, corner) = (20 * 40 + 20, 0);
    let depth = render.depth[middle];
    assert!((1.7..2.4).contains(&depth), "depth {depth}");
    assert!(
        render.opacity[middle] > 0.9 && render.opacity[middle] <= 1.0,
        "{}",
        render.opacity[middle]
    );
    assert!(
        render.rgb[corner]
            .iter()
            .all(|channel| (0.0..=1.0).contains(channel))
    );
}

/// A training that chooses six samples of a ray from its first step on.
fn choosing(views: Vec<View>, config: &Config, seed: u64) -> Training {
    let config = Config {
        ray_samples: 6,
        ..config.clone()
    };
    let mut training = Training::new(views, &[], &config, seed).unwrap();
    training.state.halvings = 1;
    assert_eq!(training.ray_samples(), 6);
    training
}

#[test]
fn weights_are_the_same_with_1_2_3_and_16_threads() {
    let digest = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let training = choosing(ball(4, 16), &small(), 7);
            let mut trainer = Trainer::from_training(training, Arc::new(Cpu::best())).unwrap();
            for _ in 0..40 {
                trainer.advance(1).unwrap();
            }
            let view = ball_view(1.0, 0.0, 16);
            (
                trainer.save().unwrap(),
                trainer.field().unwrap().encode(),
                trainer
                    .field()
                    .unwrap()
                    .render(&view.camera, &view.cam_from_world)
                    .unwrap(),
            )
        })
    };
    let one = digest(1);
    for threads in [2, 3, 16] {
        assert!(digest(threads) == one, "{threads} threads");
    }
}

#[test]
fn a_pixel_is_the_same_in_any_rows_any_bands_and_with_any_threads() {
    let field = trained(ball(4, 16), &small(), 7, 40).field().unwrap();
    // 43 columns and 37 rows: tiles are cut at both edges. Distortion folds in no corner.
    let view = ball_view(1.0, 0.3, 16);
    let camera = Camera {
        k1: 0.05,
        p2: 0.01,
        ..Camera::pinhole(43, 37, 40.0)
    };
    let whole = field.render(&camera, &view.cam_from_world).unwrap();
    for threads in [1, 2, 3, 16] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let again = pool.install(|| field.render(&camera, &view.cam_from_world).unwrap());
        assert!(again == whole, "{threads} threads");
    }
    for height in [1, 5, 8, 30] {
        for top in (0..37).step_by(height) {
            let rows = top as u32..37.min((top + height) as u32);
            let band = field.rows(&camera, &view.cam_from_world, rows).unwrap();
            let same = band.rgb == whole.rgb[top * 43..][..band.rgb.len()]
                && band.depth == whole.depth[top * 43..][..band.rgb.len()];
            assert!(same, "{height} rows from {top}");
        }
    }
    let bands = crate::render_in_bands(&field, &camera, &view.cam_from_world, || Ok::<_, FieldError>(()));
    assert!(bands == Ok(Ok(whole)));
    let nothing = Camera::pinhole(0, 5, 1.0);
    assert!(
        field
            .render(&nothing, &view.cam_from_world)
            .unwrap()
            .rgb
            .is_empty()
    );
}

#[test]
fn weights_are_the_same_on_every_instruction_set() {
    for features in [2, 4] {
        let config = Config {
            features,
            levels: Some(32 / features),
            density_width: 64,
            color_width: 32,
            color_layers: 2,
            view_dependence: match features {
                2 => ViewDependence::Off,
                _ => ViewDependence::On,
            },
            ..small()
        };
        let state = |level: InstructionSet| {
            let training = choosing(ball(3, 12), &config, 3);
            let mut trainer = Trainer::from_training(training, Arc::new(Cpu { level })).unwrap();
            for _ in 0..20 {
                trainer.advance(1).unwrap();
            }
            let field = trainer.field().unwrap();
            let view = ball_view(1.0, 0.0, 12);
            (
                trainer.save().unwrap(),
                field.render(&view.camera, &view.cam_from_world).unwrap(),
            )
        };
        let levels = InstructionSet::all();
        let plain = state(levels[0]);
        for level in &levels[1..] {
            assert!(state(*level) == plain, "{level:?}, {features} features");
        }
    }
}

#[test]
fn a_resumed_training_gives_the_bytes_of_an_uninterrupted_one() {
    let mut whole = trained(ball(4, 16), &small(), 7, 60);
    let mut half = trained(ball(4, 16), &small(), 7, 37);
    let mut resumed = Trainer::new(ball(4, 16), &[], &small(), 7).unwrap();
    resumed.restore(&half.save().unwrap()).unwrap();
    assert_eq!(resumed.steps(), 37);
    for _ in 37..60 {
        resumed.advance(1).unwrap();
    }
    assert!(
        resumed.save().unwrap() == whole.save().unwrap()
            && resumed.field().unwrap().encode() == whole.field().unwrap().encode()
    );
}

#[test]
fn a_box_is_fitted_to_the_matter_that_was_found() {
    let config = Config {
        refit_steps: Some(135),
        batch_samples: 4096,
        ..small()
    };
    let mut trainer = trained(ball(12, 24), &config, 1, 127);
    let before = trainer.training.frame.clone();
    let resume = |from: &mut Trainer| {
        let mut resumed = Trainer::new(ball(12, 24), &[], &config, 1).unwrap();
        resumed.restore(&from.save().unwrap()).unwrap();
        resumed
    };
    let mut resumed = resume(&mut trainer);
    for trainer in [&mut trainer, &mut resumed] {
        trainer.advance(1).unwrap();
    }
    let after = trainer.training.frame.clone();
    // Cameras are 3 from a ball of radius 1.
    assert!(before.half_side > 2.5, "{before:?}");
    assert!((0.6..1.2).contains(&after.half_side), "{after:?}");
    assert!(after.origin.iter().all(|x| x.abs() < 0.3), "{after:?}");
    assert!(after.reason.starts_with("after 128 steps"), "{after:?}");
    // From a state before and from one behind, a resumed training continues with the same bytes.
    let mut behind = resume(&mut trainer);
    for trainer in [&mut trainer, &mut resumed, &mut behind] {
        for _ in 0..72 {
            trainer.advance(1).unwrap();
        }
    }
    let bytes = trainer.save().unwrap();
    assert!(resumed.save().unwrap() == bytes && behind.save().unwrap() == bytes);
    assert_eq!(trainer.training.frame, after);
    let score = psnr(&trainer.field().unwrap(), &ball_view(0.4, 0.3, 24));
    assert!(score > 20.0, "{score} dB");
}

#[test]
fn a_box_stays_where_nothing_was_found_or_where_points_have_told_it() {
    let config = Config {
        refit_steps: Some(16),
        ..small()
    };
    let mut views = ball(4, 16);
    views.iter_mut().for_each(|view| view.image.pixels.fill([90; 3]));
    let trainer = trained(views.clone(), &config, 1, 17);
    assert_eq!(trainer.training.frame, crate::frame::Frame::derive(&views, &[]));
    let points: Vec<[f64; 3]> = (0..40).map(|index| [0.01 * f64::from(index), 0.1, 0.0]).collect();
    let told = Training::new(views, &points, &config, 1).unwrap();
    assert_eq!(told.refit_step, None);
}

#[test]
fn a_checkpoint_of_another_training_or_a_damaged_one_is_refused() {
    let state = trained(ball(4, 16), &small(), 7, 3).save().unwrap();
    let other = |seed, views, config: &Config| {
        let mut trainer = Trainer::new(views, &[], config, seed).unwrap();
        trainer.restore(&state)
    };
    assert_eq!(
        other(8, ball(4, 16), &small()),
        Err(FieldError::OtherTraining { what: "seed" })
    );
    let what = "photos, cameras or box";
    let mut views = ball(4, 16);
    views[2].image.pixels[5][1] ^= 1;
    assert_eq!(other(7, views, &small()), Err(FieldError::OtherTraining { what }));
    let config = Config {
        near: Some(0.3),
        ..small()
    };
    assert_eq!(
        other(7, ball(4, 16), &config),
        Err(FieldError::OtherTraining { what: "config" })
    );
    let mut trainer = Trainer::new(ball(4, 16), &[], &small(), 7).unwrap();
    let before = trainer.save().unwrap();
    for cut in [0, 7, 100, state.len() / 2, state.len() - 1] {
        let error = trainer.restore(&state[..cut]).unwrap_err();
        assert!(matches!(error, FieldError::Malformed { .. }), "{cut}: {error}");
    }
    assert!(trainer.save().unwrap() == before);
}

#[test]
fn seeds_that_differ_in_one_high_bit_give_other_weights() {
    let weights = |seed| trained(ball(2, 8), &small(), seed, 2).field().unwrap().encode();
    let one = weights(1);
    for bit in [0, 31, 32, 53, 63] {
        assert!(weights(1 ^ (1 << bit)) != one, "bit {bit}");
    }
}

#[test]
fn a_field_survives_its_bytes_and_refuses_damaged_ones() {
    let field = trained(ball(3, 12), &small(), 2, 20).field().unwrap();
    let bytes = field.encode();
    let back = Field::decode(&bytes).unwrap();
    assert!(back.encode() == bytes);
    let view = ball_view(0.2, 0.1, 12);
    let (one, other) = (
        field.render(&view.camera, &view.cam_from_world).unwrap(),
        back.render(&view.camera, &view.cam_from_world).unwrap(),
    );
    assert_eq!(one, other);
    for cut in [0, 8, 200, bytes.len() - 1] {
        let error = Field::decode(&bytes[..cut]).unwrap_err();
        assert!(
            matches!(error, FieldError::Malformed { what: "field", .. }),
            "{cut}: {error}"
        );
    }
    let mut nan = field.clone();
    nan.model.weights.tables[1][5] = f32::NAN;
    let error = Field::decode(&nan.encode()).unwrap_err().to_string();
    assert_eq!(error, "not a field: `table.1` is NaN at 5");
    let text = String::from_utf8_lossy(&bytes).replacen("\\\"levels\\\":4", "\\\"levels\\\":8", 1);
    assert!(Field::decode(text.as_bytes()).is_err());
    let mut larger = field;
    larger.model.facts.sizes.log2_table.value = 24;
    let error = Field::decode(&larger.encode()).unwrap_err().to_string();
    assert!(error.starts_with("not a field: tensor `table."), "{error}");
}

#[test]
fn a_black_background_stays_black_where_nothing_is() {
    let config = Config {
        background: Background::Black,
        ..small()
    };
    let trainer = trained(ball(3, 12), &config, 4, 10);
    assert!(
        trainer
            .training
            .state
            .weights
            .background
            .iter()
            .all(|value| *value == 0.0)
    );
}

/// The ball cut out, all of it black: over black its photos are black everywhere.
fn cut_out_and_black(count: u32, width: u32) -> Vec<View> {
    let is_ball = |rgb: [f32; 3]| rgb[0] > rgb[2];
    let cut = |view: View| {
        let alpha: Vec<u8> = (0..view.image.count())
            .map(|kept| if is_ball(view.image.at(kept).1) { 255 } else { 0 })
            .collect();
        let image = Image::from_fn(width, width, |_, _| [0; 3]);
        View {
            image: Pixels::from(image).with_alpha(&alpha),
            ..view
        }
    };
    ball(count, width).into_iter().map(cut).collect()
}

#[test]
fn a_black_thing_is_told_from_nothing_by_its_transparency() {
    let mut trainer = trained(cut_out_and_black(12, 24), &small(), 4, 200);
    assert_eq!(trainer.training.config.background, Background::Black);
    let field = trainer.field().unwrap();
    let view = ball_view(0.3, 0.2, 24);
    let render = field.render(&view.camera, &view.cam_from_world).unwrap();
    let (middle, corner) = (render.opacity[12 * 24 + 12], render.opacity[0]);
    assert!(middle > 0.9 && corner < 0.1, "{middle} {corner}");
    let opaque = |view: View| View {
        image: Image::from_fn(24, 24, |_, _| [0; 3]).into(),
        ..view
    };
    let views = cut_out_and_black(12, 24).into_iter().map(opaque).collect();
    let blind = trained(views, &small(), 4, 200).field().unwrap();
    let render = blind.render(&view.camera, &view.cam_from_world).unwrap();
    assert!(
        render.opacity[12 * 24 + 12] < 0.5,
        "{}",
        render.opacity[12 * 24 + 12]
    );
}

#[test]
fn photos_without_transparency_still_teach_the_background() {
    let mut views = ball(6, 12);
    views.extend(cut_out_and_black(6, 12));
    let trained = trained(views.clone(), &small(), 4, 10).training;
    assert_eq!(trained.config.background, Background::Direction);
    let alone = Trainer::new(ball(6, 12), &[], &small(), 4).unwrap().training;
    let first = Trainer::new(views, &[], &small(), 4).unwrap().training;
    assert_eq!(
        first.state.weights.background, alone.state.weights.background,
        "what it starts from is of the opaque photos alone"
    );
    assert_ne!(trained.state.weights.background, first.state.weights.background);
}

/// Changes only when training answers differently: then the stages built on it raise their VERSION.
const FINGERPRINT_OF_TWENTY_STEPS: u64 = 0x8664_a1eb_b896_b67a;

#[test]
fn twenty_steps_on_exact_views_give_the_known_bytes() {
    let view = |eye: [f64; 3], shade: u32| View {
        id: format!("exact {shade}"),
        camera: Camera::pinhole(12, 10, 12.0),
        // Multiples of 1/2 and rotations of 0 and 1 only: the same bits on every platform.
        cam_from_world: Pose {
            translation: Vector3::from(eye),
            ..Pose::identity()
        },
        image: Image::from_fn(12, 10, |x, y| {
            [(x * 20) as u8, (y * 25) as u8, (shade * 60) as u8]
        })
        .into(),
        distances: Vec::new(),
    };
    let views = vec![
        view([0.5, 0.0, 2.0], 0),
        view([-0.5, 0.0, 2.0], 1),
        view([0.0, 0.5, 2.5], 2),
    ];
    let bytes = trained(views, &small(), 9, 20).field().unwrap().encode();
    let mut sum = crate::rng::Fingerprint::default();
    sum.add(bytes.iter().map(|byte| u64::from(*byte)));
    assert_eq!(
        sum.0, FINGERPRINT_OF_TWENTY_STEPS,
        "training answers differently: {:#018x}; raise the VERSION of `train` and write the new number here",
        sum.0
    );
}
