//! Whole trainings and pictures on a software adapter, compared with the CPU's.

use std::sync::Arc;

use super::record::Work;
use super::session::GpuSession;
use super::testing::{advance, gpu, on_gpu, own_gpu, settled, upload, worst};
use super::totals::LATE_FROM;
use marf_field::test_scene::{ball, psnr, small};
use marf_field::training::Training;
use marf_field::{Config, Field, FieldError, Gain, Pace, Step, Trainer};

fn config() -> Config {
    Config {
        batch_samples: 1024,
        occupancy_resolution: 32,
        ..small()
    }
}

#[test]
fn a_first_step_on_both_devices_ends_at_the_same_weights() {
    let Some(gpu) = gpu("a_first_step_on_both_devices_ends_at_the_same_weights") else {
        return;
    };
    let mut there = on_gpu(&gpu, ball(4, 16), &[], &config(), 7);
    let mut here = Trainer::new(ball(4, 16), &[], &config(), 7).unwrap();
    let (on_gpu, on_cpu) = (settled(&mut there, 1).unwrap(), here.advance(1).unwrap());
    assert_eq!((on_gpu.steps, on_gpu.rays), (1, on_cpu.rays));
    // A sample may fall on the other side of a border of a cell, or of what still shows.
    assert!(on_gpu.samples.abs_diff(on_cpu.samples) <= 2 + on_cpu.samples / 1000);
    let apart = (on_gpu.loss - on_cpu.loss).abs();
    assert!(apart < 1e-5 * on_cpu.loss, "{on_gpu:?} {on_cpu:?}");
    there.sync().unwrap();
    let bits = |trainer: &Trainer| {
        trainer
            .training
            .state
            .scales
            .iter()
            .map(|scale| scale.log2())
            .collect::<Vec<_>>()
    };
    println!("scales {:?}", bits(&there));
    // Adam's first step is a whole step size whatever the gradient. Where it is rounding noise, its sign may
    // differ. In tables, noise is all that is less than some quanta, and the first scale is a guess.
    let rate = config().learning_rate as f32;
    for ((name, there), (_, here)) in there
        .training
        .state
        .weights
        .tensors()
        .iter()
        .zip(here.training.state.weights.tensors())
    {
        let far = there
            .iter()
            .zip(here)
            .filter(|(a, b)| (**a - **b).abs() > 0.1 * rate);
        let share = far.count() as f64 / there.len() as f64;
        println!("{name}: worst {:e}, {share:.4} apart", worst(there, here).0);
        let most = if name.starts_with("table") { 0.1 } else { 0.01 };
        assert!(share < most, "{name}: {share} of the weights are apart");
    }
}

#[test]
fn a_ball_is_learnt_as_well_as_on_the_cpu_and_twice_with_the_same_bytes() {
    let name = "a_ball_is_learnt_as_well_as_on_the_cpu_and_twice_with_the_same_bytes";
    let Some(gpu) = gpu(name) else {
        return;
    };
    let (views, config) = (
        ball(12, 24),
        Config {
            batch_samples: 2048,
            ..config()
        },
    );
    let mut there = on_gpu(&gpu, views.clone(), &[], &config, 1);
    let mut again = on_gpu(&gpu, views.clone(), &[], &config, 1);
    let mut here = Trainer::new(views.clone(), &[], &config, 1).unwrap();
    for trainer in [&mut there, &mut again] {
        advance(trainer, 64);
    }
    assert!(there.save().unwrap() == again.save().unwrap(), "two runs differ");
    for trainer in [&mut there, &mut here] {
        advance(trainer, 200);
    }
    let fields = [there.field().unwrap(), here.field().unwrap()];
    let mean = |field: &Field| views.iter().map(|view| psnr(field, view)).sum::<f64>() / views.len() as f64;
    let [on_gpu, on_cpu] = fields.each_ref().map(mean);
    println!(
        "scales {:?}",
        there
            .training
            .state
            .scales
            .iter()
            .map(|scale| scale.log2())
            .collect::<Vec<_>>()
    );
    println!("after 200 steps: {on_gpu:.3} dB on the GPU, {on_cpu:.3} dB on the CPU");
    assert!(
        (on_gpu - on_cpu).abs() < 0.3 && on_cpu > 20.0,
        "{on_gpu} against {on_cpu}"
    );
}

#[test]
fn a_device_without_wide_atomics_learns_the_same_bytes() {
    let name = "a_device_without_wide_atomics_learns_the_same_bytes";
    let (Some(wide), Some(mut plain)) = (gpu(name), own_gpu(name)) else {
        return;
    };
    // With them `scatter_packed` runs, without `scatter`.
    plain.features.remove(wgpu::Features::SHADER_INT64);
    let [wide, plain] = [wide, Arc::new(plain)].map(|gpu| {
        let mut trainer = on_gpu(&gpu, ball(4, 16), &[], &config(), 7);
        advance(&mut trainer, 20);
        trainer.sync().unwrap();
        trainer.training.state
    });
    assert!(wide == plain);
}

/// A card pays for each in microseconds.
#[test]
fn a_step_takes_20_dispatches_and_two_more_where_photos_have_exposures_whatever_the_networks() {
    let name = "a_step_takes_20_dispatches_and_two_more_where_photos_have_exposures_whatever_the_networks";
    let Some(gpu) = gpu(name) else {
        return;
    };
    for (gain, dispatches) in [(Gain::Off, 20), (Gain::PerPhotoAndOffset, 22)] {
        for color_layers in [1, 3] {
            let config = Config {
                gain,
                color_layers,
                ..config()
            };
            let mut training = Training::new(ball(4, 16), &[], &config, 7).unwrap();
            let session = GpuSession::new(&gpu, &mut training).unwrap();
            let work = Work::recorded(|recorder| session.record(recorder, 1));
            assert_eq!(work.len(), dispatches, "{gain:?}, {color_layers}");
        }
    }
}

#[test]
fn a_picture_is_the_same_on_both_devices() {
    let Some(gpu) = gpu("a_picture_is_the_same_on_both_devices") else {
        return;
    };
    let views = ball(12, 24);
    let mut trainer = Trainer::new(views.clone(), &[], &config(), 1).unwrap();
    advance(&mut trainer, 150);
    let here = trainer.field().unwrap();
    let there = Field::new(here.model.clone(), gpu.clone()).unwrap();
    let (camera, pose) = (&views[0].camera, &views[0].cam_from_world);
    let there = there.render(camera, pose).unwrap();
    let here = marf_field::test_scene::exact(&here.model, camera, pose);
    // A sample on the border of a cell may be on its other side.
    let pairs = there.rgb.iter().zip(&here.rgb);
    let apart = pairs.filter(|(a, b)| worst(*a, *b).0 > 1.0 / 128.0).count();
    let (colour, _) = worst(there.rgb.as_flattened(), here.rgb.as_flattened());
    println!(
        "picture: {apart} of {} pixels apart, worst {colour:e}",
        here.rgb.len()
    );
    assert!(apart < here.rgb.len() / 100, "{apart}");
}

#[test]
fn a_training_on_a_gpu_goes_on_from_a_checkpoint_with_the_same_bytes() {
    let name = "a_training_on_a_gpu_goes_on_from_a_checkpoint_with_the_same_bytes";
    let Some(gpu) = gpu(name) else {
        return;
    };
    let config = Config {
        gain: Gain::PerPhotoAndOffset,
        ..config()
    };
    let mut whole = on_gpu(&gpu, ball(4, 16), &[], &config, 7);
    advance(&mut whole, 37);
    let kept = whole.save().unwrap();
    advance(&mut whole, 60);
    let mut resumed = on_gpu(&gpu, ball(4, 16), &[], &config, 7);
    resumed.restore(&kept).unwrap();
    assert_eq!(resumed.steps(), 37);
    advance(&mut resumed, 60);
    assert!(whole.save().unwrap() == resumed.save().unwrap());
    let mut here = Trainer::new(ball(4, 16), &[], &config, 7).unwrap();
    let refused = here.restore(&kept);
    assert_eq!(refused, Err(FieldError::OtherTraining { what: "device" }));
}

/// Steps are reported one call late, so that the device need not wait: each once, whoever asks in between.
#[test]
fn a_training_that_is_settled_after_every_call_learns_the_same_bytes_and_tells_as_much() {
    let name = "a_training_that_is_settled_after_every_call_learns_the_same_bytes_and_tells_as_much";
    let Some(gpu) = gpu(name) else {
        return;
    };
    // So few steps a ray that they are halved every 128 steps, also once costs are late.
    let config = Config {
        near: Some(0.5),
        far: Some(1.0),
        cone: 0.25,
        min_step: 0.5,
        halvings: Some(3),
        batch_samples: 256,
        ray_samples: 4,
        ..config()
    };
    let made = || on_gpu(&gpu, ball(4, 16), &[], &config, 7);
    let (mut late, mut settled_often) = (made(), made());
    let mut told = [Step::default(); 2];
    for end in (16..=400).step_by(16) {
        told[0] = told[0].and(late.advance(16).unwrap());
        told[1] = told[1].and(settled(&mut settled_often, 16).unwrap());
        let awaited = if end > LATE_FROM { 16 } else { 0 };
        assert_eq!([late.steps(), told[0].steps + awaited], [end; 2]);
    }
    told[0] = told[0].and(late.settle().unwrap());
    assert_eq!(late.settle(), Ok(Step::default()));
    let [late_told, often_told] = told;
    let counts = |step: Step| [step.steps, step.rays, step.samples];
    assert_eq!(counts(late_told), counts(often_told));
    assert!((late_told.loss / often_told.loss - 1.0).abs() < 1e-12);
    let state = &late.training.state;
    assert_eq!(state.halvings, 3, "{} samples a ray", state.samples_per_ray);
    assert_eq!(late.training.ray_samples(), 4);
    assert!(late.save().unwrap() == settled_often.save().unwrap());
}

#[test]
fn a_nan_stops_the_step_by_name_and_leaves_the_state_before_it() {
    let Some(gpu) = gpu("a_nan_stops_the_step_by_name_and_leaves_the_state_before_it") else {
        return;
    };
    let mut trainer = on_gpu(&gpu, ball(4, 16), &[], &config(), 7);
    advance(&mut trainer, 20);
    let good = trainer.save().unwrap();
    for tensor in ["background", "density", "table"] {
        trainer.restore(&good).unwrap();
        let mut broken = trainer.training.state.clone();
        let mut tensors = broken.weights.tensors_mut();
        let found = tensors.iter_mut().find(|(name, _)| name.starts_with(tensor));
        found.unwrap().1.fill(f32::NAN);
        drop(tensors);
        trainer.training.state = broken;
        upload(&mut trainer);
        let refused = settled(&mut trainer, 5).unwrap_err();
        assert!(
            matches!(refused, FieldError::NotFinite { step: 20, .. }),
            "{tensor}: {refused}"
        );
        assert_eq!(trainer.steps(), 20);
    }
}

#[test]
fn a_box_is_fitted_as_on_the_cpu_and_a_resumed_training_goes_on_in_it() {
    let Some(gpu) = gpu("a_box_is_fitted_as_on_the_cpu_and_a_resumed_training_goes_on_in_it") else {
        return;
    };
    let config = Config {
        refit_steps: Some(128),
        ..config()
    };
    let made = || on_gpu(&gpu, ball(12, 24), &[], &config, 1);
    let (mut there, mut resumed) = (made(), made());
    let mut here = Trainer::new(ball(12, 24), &[], &config, 1).unwrap();
    let at_first = here.training.frame.half_side;
    for trainer in [&mut there, &mut here] {
        advance(trainer, 128);
    }
    let [on_gpu, on_cpu] = [&there, &here].map(|trainer| trainer.training.frame.half_side);
    assert!(on_cpu < 0.5 * at_first, "{on_cpu} of {at_first}");
    // Weights drift apart by rounding. The box is an 80th percentile of some thousand depths.
    assert!(
        (on_gpu / on_cpu - 1.0).abs() < 0.1,
        "{on_gpu} on the GPU, {on_cpu} on the CPU"
    );
    resumed.restore(&there.save().unwrap()).unwrap();
    for trainer in [&mut there, &mut resumed] {
        advance(trainer, 160);
    }
    assert!(there.save().unwrap() == resumed.save().unwrap());
}

/// With a planted pace of 0.1 M samples/s two steps of 2^13 fit where one of 2^15 would. The learnt state
/// stays.
#[test]
fn a_batch_follows_the_pace_of_a_device_and_what_was_learnt_stays() {
    let name = "a_batch_follows_the_pace_of_a_device_and_what_was_learnt_stays";
    let Some(gpu) = gpu(name) else {
        return;
    };
    let mut trainer = on_gpu(&gpu, ball(4, 16), &[], &config(), 7);
    advance(&mut trainer, 16);
    let pace = |samples: f64| Pace {
        steps: 1.0,
        rays: 1.0,
        samples,
    };
    let weights = |trainer: &mut Trainer| {
        trainer.sync().unwrap();
        trainer.training.state.weights.tables.clone()
    };
    let before = weights(&mut trainer);
    assert_eq!(trainer.suit(&pace(0.1e6)), Ok(true));
    assert_eq!((trainer.steps(), trainer.batch_samples()), (16, 1 << 13));
    assert!(weights(&mut trainer) == before, "changed");
    let step = settled(&mut trainer, 16).unwrap();
    assert!(step.samples > 16 << 12, "{step:?}");
    assert_eq!(trainer.suit(&pace(0.1e6)), Ok(false), "it is that batch");
}
