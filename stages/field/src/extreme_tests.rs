//! The extremes of training and rendering (issue 4, item 5). The message holds the value that breaks.
//! Constant photos, one photo, one pixel and photos of different sizes are tested in `training_tests.rs`.

use marf_scene::{Camera, Image, Pose};
use nalgebra::Vector3;

use crate::batch::{self, Spares, StepContext};
use crate::cpu::clearance::Clearance;
use crate::cpu::simd::InstructionSet;
use crate::cpu::space::Bits;
use crate::draw::Target;
use crate::exposure::Exposure;
use crate::frame::RayStart;
use crate::test_scene::{ball, ball_view, small, trained};
use crate::{Background, Config, FieldError, Trainer, View};

fn refused(trainer: &mut Trainer) -> String {
    let before = trainer.save().unwrap();
    let Err(error) = trainer.advance(1) else {
        return "trained on".to_owned();
    };
    assert!(trainer.save().unwrap() == before, "changed by {error}");
    assert!(matches!(error, FieldError::NotFinite { .. }), "{error}");
    error.to_string()
}

#[test]
fn a_nan_in_any_tensor_stops_the_step_by_name_and_leaves_the_state() {
    let good = trained(ball(3, 12), &small(), 2, 5).save().unwrap();
    let names = [
        "table.0",
        "table.3",
        "density.0",
        "density.1",
        "color.0",
        "color.1",
        "background",
    ];
    for name in names {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut trainer = Trainer::new(ball(3, 12), &[], &small(), 2).unwrap();
            trainer.restore(&good).unwrap();
            let moments = trainer.training.state.moments.clone();
            let mut tensors = trainer.training.state.weights.tensors_mut();
            let place = tensors.iter().position(|(tensor, _)| tensor == name).unwrap();
            // An entry that training reaches: the one touched most often.
            let row = (0..moments[place].count.len())
                .max_by_key(|row| moments[place].count[*row])
                .unwrap();
            let width = tensors[place].1.len() / moments[place].count.len();
            tensors[place].1[row * width..][..width].fill(value);
            trainer.training.state.weights.refresh();
            let text = refused(&mut trainer);
            assert!(
                text.starts_with("step 5: `")
                    && text.contains("` is not finite, or beyond 1e9, at ")
                    && text.ends_with("lower `learning_rate` (now 0.02)"),
                "{value} in {name}: {text}"
            );
            trainer.restore(&good).unwrap();
            assert!(
                trainer.advance(1).is_ok(),
                "{value} in {name}: a good checkpoint goes on"
            );
        }
    }
    let mut trainer = trained(ball(3, 12), &small(), 2, 5);
    trainer.training.state.gains[5] = f32::NAN;
    let text = refused(&mut trainer);
    assert!(
        text.starts_with("step 5: `gains` is not finite, or beyond 1e9, at 5"),
        "{text}"
    );
}

/// A training can continue from every state that it leaves behind.
#[test]
fn a_rate_that_is_too_high_stops_by_name_or_leaves_a_state_that_can_be_taken_back() {
    // At 200 the second moment of a gain became infinite, and no checkpoint of it could be read.
    for rate in [0.3, 1.0, 20.0, 200.0, 1e6, 1e30] {
        let config = Config {
            density_width: 128,
            color_width: 128,
            color_layers: 3,
            ..small()
        };
        let mut trainer = Trainer::new(ball(3, 12), &[], &config, 2).unwrap();
        trainer.training.config.learning_rate = rate;
        for step in 0..40 {
            let before = trainer.save().unwrap();
            assert_eq!(trainer.restore(&before), Ok(()), "rate {rate:e}, step {step}");
            if let Err(error) = trainer.advance(1) {
                let text = error.to_string();
                assert!(
                    text.starts_with(&format!("step {step}: `")),
                    "rate {rate:e}: {text}"
                );
                assert!(
                    trainer.save().unwrap() == before,
                    "rate {rate:e}: changed by {text}"
                );
                break;
            }
            assert!(rate < 1e6 || step == 0, "rate {rate:e} went on to step {step}");
        }
    }
}

/// Returns the error of a batch for one ray with these numbers. 8-bit photos and checked cameras give no such
/// ray.
fn batch_of(target: Target) -> Option<&'static str> {
    let trainer = trained(ball(3, 12), &small(), 2, 5);
    let shared = StepContext {
        level: InstructionSet::best(),
        config: &small(),
        weights: &trainer.training.state.weights,
        steps: &trainer.training.sizes.steps(&small(), 0),
        bits: &trainer.training.state.occupancy.bits,
        clearance: &Clearance::new(&trainer.training.state.occupancy.bits),
        rays: 1,
        ray_samples: 32,
        distortion: 1e-3,
    };
    let mut chunks = Vec::new();
    batch::train(&shared, &[target], 4, &mut chunks, &Spares::default());
    chunks[0].found.bad
}

#[test]
fn a_nan_in_a_pixel_a_gain_or_a_ray_is_named() {
    let start = RayStart {
        origin: [0.0, 0.0, -1.0],
        direction: [0.0, 0.0, 1.0],
    };
    let good = Target {
        start: Some(start),
        jitter: 0.5,
        view: 0,
        rgb: [0.5; 3],
        exposure: Exposure {
            gain: [1.0; 3],
            offset: [0.0; 3],
        },
        pull: None,
        behind: None,
    };
    assert_eq!(batch_of(good), None);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let rgb = [0.5, bad, 0.5];
        assert_eq!(batch_of(Target { rgb, ..good }), Some("loss"), "pixel {bad}");
        let gain = [1.0, 1.0, bad];
        let exposure = Exposure {
            gain,
            ..good.exposure
        };
        let target = Target { exposure, ..good };
        assert_eq!(batch_of(target), Some("loss"), "gain {bad}");
        let start = Some(RayStart {
            direction: [0.0, bad, 1.0],
            ..start
        });
        // Where the samples weigh too little for a colour, only the background looks along the ray.
        let named = batch_of(Target { start, ..good });
        let names = [Some("colour logits"), Some("gradient of the background")];
        assert!(names.contains(&named), "direction {bad}: {named:?}");
    }
    // A ray without a place in the photo's camera trains nothing.
    assert_eq!(batch_of(Target { start: None, ..good }), None);
}

#[test]
fn a_camera_whose_numbers_overflow_is_refused_by_name_before_the_first_step() {
    let refused = |views: Vec<View>, points: &[[f64; 3]]| {
        Trainer::new(views, points, &small(), 0)
            .err()
            .map(|error| error.to_string())
    };
    for away in [1e8, 1e30, 1e100, 1e200, 1e308] {
        let mut views = ball(3, 8);
        views[2].cam_from_world.translation.x = away;
        // Points hold the box. Without them it grows with the cameras until its own side overflows.
        let points: Vec<[f64; 3]> = (0..64)
            .map(|i| [f64::from(i % 4), f64::from(i / 4 % 4), f64::from(i / 16)])
            .collect();
        let text = refused(views.clone(), &points).unwrap_or_else(|| panic!("{away:e} with points"));
        assert!(
            text.starts_with("view `ball 4.19`: its camera lies at "),
            "{away:e}: {text}"
        );
        if let Some(text) = refused(views, &[]) {
            assert!(
                away > 1e100 && text.contains("its camera lies at "),
                "{away:e}: {text}"
            );
        }
    }
    for bad in [f64::NAN, f64::INFINITY] {
        let mut views = ball(2, 8);
        views[0].camera.fx_px = bad;
        let text = refused(views, &[]).unwrap_or_default();
        assert!(
            text.starts_with("view `ball 0.00`: camera or pose"),
            "focal length {bad}: {text}"
        );
        let mut views = ball(2, 8);
        views[0].cam_from_world.rotation[(1, 2)] = bad;
        let text = refused(views, &[]).unwrap_or_default();
        assert!(
            text.starts_with("view `ball 0.00`: camera or pose"),
            "rotation {bad}: {text}"
        );
    }
}

#[test]
fn cameras_a_hundred_thousand_half_sides_away_train_and_see_the_box() {
    // The ball of radius 1 fills the photo from 1e5 away. Sparse points on it hold the box and near and far.
    let points: Vec<[f64; 3]> = (0..64)
        .map(|i| {
            let angle = f64::from(i);
            [angle.cos(), angle.sin(), f64::from(i) / 32.0 - 1.0]
        })
        .collect();
    let view = |index: u32| {
        let angle = f64::from(index) * 1.5;
        let eye = Vector3::new(angle.cos(), angle.sin(), 0.2) * 1e5;
        View {
            id: format!("far {index}"),
            camera: Camera::pinhole(16, 16, 6e5),
            cam_from_world: Pose::looking_at(eye, Vector3::zeros(), -Vector3::z()),
            image: Image::from_fn(16, 16, |x, y| [(x * 15) as u8, (y * 15) as u8, 90]).into(),
            distances: Vec::new(),
        }
    };
    let views: Vec<View> = (0..4).map(view).collect();
    let mut trainer = Trainer::new(views.clone(), &points, &small(), 3).unwrap();
    for step in 0..20 {
        let found = trainer.advance(1).unwrap();
        assert!(
            found.samples > 0 && found.loss.is_finite(),
            "step {step}: {found:?}"
        );
    }
    let render = trainer
        .field()
        .unwrap()
        .render(&views[0].camera, &views[0].cam_from_world)
        .unwrap();
    assert!(
        render
            .rgb
            .as_flattened()
            .iter()
            .chain(&render.depth)
            .all(|value| value.is_finite())
    );
}

#[test]
fn near_at_far_or_behind_it_is_refused_and_a_hair_before_it_trains() {
    for (near, far) in [(1.0, 1.0), (2.0, 1.0), (1e-4, 1e-4)] {
        let config = Config {
            near: Some(near),
            far: Some(far),
            ..small()
        };
        let error = Trainer::new(ball(2, 8), &[], &config, 0)
            .err()
            .map(|error| error.to_string());
        assert_eq!(
            error,
            Some(format!("`far` is {far}, must be above `near`, at most 1000000"))
        );
    }
    let config = Config {
        near: Some(1.0),
        far: Some(1.0 + f64::EPSILON),
        ..small()
    };
    let mut trainer = Trainer::new(ball(2, 8), &[], &config, 0).unwrap();
    let step = trainer.advance(1).unwrap();
    assert!(
        step.rays > 0 && step.loss.is_finite(),
        "near 1, far 1 + 2^-52: {step:?}"
    );
}

#[test]
fn tables_of_2_to_8_up_to_2_to_24_entries_train() {
    for log2_table in [8, 10, 14, 19, 24] {
        // Only the finest level has more corners than entries: five copies of 2^24 rows of 2 numbers are 0.7 GB.
        let most = (1..=256).find(|side| (side + 1_u64).pow(3) > 1 << log2_table);
        let config = Config {
            levels: Some(8),
            features: 2,
            log2_table: Some(log2_table),
            base_resolution: 4,
            finest_resolution: most.map(|side| side as u32),
            ..small()
        };
        let trainer = trained(ball(2, 8), &config, 0, 2);
        let shape = trainer.training.state.weights.shapes[7];
        assert_eq!(
            (shape.entries, shape.dense),
            (1 << log2_table, false),
            "2^{log2_table}"
        );
        let moved = trainer.training.state.moments[7]
            .count
            .iter()
            .filter(|count| **count > 0)
            .count();
        assert!(moved > 50, "2^{log2_table}: {moved} entries moved");
    }
}

/// A photo of 4000 x 2500 is trained on, then seen through a camera as large. No cell but the ball's is occupied.
#[test]
fn ten_million_pixels_are_trained_on_and_ten_million_rays_rendered() {
    let config = Config {
        near: Some(0.2),
        far: Some(4.0),
        min_step: 0.5,
        cone: 0.25,
        ..small()
    };
    let mut view = ball_view(0.0, 0.0, 1);
    view.camera = Camera::pinhole(4000, 2500, 4000.0);
    view.image = Image::from_fn(4000, 2500, |x, y| [(x >> 4) as u8, (y >> 4) as u8, 0]).into();
    let mut field = trained(vec![view.clone(), ball_view(2.0, 0.0, 8)], &config, 0, 3)
        .field()
        .unwrap();
    field.model.bits = Bits::new(field.model.bits.side);
    let middle = field.model.bits.side / 2;
    field
        .model
        .bits
        .set(((middle * field.model.bits.side + middle) * field.model.bits.side + middle) as usize);
    let asked = std::cell::Cell::new(0);
    let all = crate::render_in_bands(&field, &view.camera, &view.cam_from_world, || {
        asked.set(asked.get() + 1);
        Ok::<_, FieldError>(())
    });
    let all = all.unwrap().unwrap();
    assert_eq!(
        (all.rgb.len(), all.opacity.len(), all.depth.len()),
        (10_000_000, 10_000_000, 10_000_000)
    );
    assert!(asked.get() > 100, "in bands that can be stopped: {}", asked.get());
    assert!(
        all.rgb
            .as_flattened()
            .iter()
            .all(|value| (0.0..=1.0).contains(value))
    );
    assert!(
        all.depth
            .iter()
            .chain(&all.opacity)
            .all(|value| *value >= 0.0 && value.is_finite())
    );
    let last = field
        .rows(&view.camera, &view.cam_from_world, 2493..2500)
        .unwrap();
    assert!(
        all.rgb[2493 * 4000..] == last.rgb,
        "the last rows are those of the last rows alone"
    );
    assert!(
        all.rgb[0] != all.rgb[9_999_999],
        "corners look into different skies"
    );
}

#[test]
fn a_camera_that_is_nowhere_renders_finite_numbers() {
    let field = trained(ball(3, 12), &small(), 2, 5).field().unwrap();
    for bad in [f64::NAN, f64::INFINITY, 1e300, -1e39] {
        let mut pose = ball_view(0.0, 0.0, 8).cam_from_world;
        pose.translation.y = bad;
        let mut turned = ball_view(0.0, 0.0, 8).cam_from_world;
        turned.rotation[(0, 0)] = bad;
        for pose in [pose, turned] {
            let render = field.render(&Camera::pinhole(8, 8, 8.0), &pose).unwrap();
            let numbers = render
                .rgb
                .as_flattened()
                .iter()
                .chain(&render.opacity)
                .chain(&render.depth);
            assert!(
                numbers.into_iter().all(|value| value.is_finite()),
                "{bad}: {render:?}"
            );
        }
    }
}

/// Only noise is left to learn once a constant photo is matched: nothing may drift away on it.
#[test]
fn a_black_photo_before_a_black_background_stays_matched_for_a_thousand_steps() {
    let config = Config {
        background: Background::Black,
        ..small()
    };
    let mut views = ball(2, 8);
    views.iter_mut().for_each(|view| view.image.pixels.fill([0; 3]));
    let mut trainer = Trainer::new(views, &[], &config, 1).unwrap();
    let mut worst = 0.0_f64;
    for step in 0..1000 {
        let loss = trainer.advance(1).unwrap().loss;
        if step >= 300 {
            worst = worst.max(loss);
        }
    }
    assert!(worst < 1e-4, "loss {worst:e} after it was matched");
    let bytes = trainer.field().unwrap().encode();
    assert!(
        crate::Field::decode(&bytes).is_ok(),
        "a field of black photos is finite"
    );
}
