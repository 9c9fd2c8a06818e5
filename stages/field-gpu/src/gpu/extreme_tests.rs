//! The extremes of training and rendering on a device: what the CPU bears, and what only a device can do.

use std::sync::Arc;

use marf_scene::{Camera, Image, Pose};
use marf_shaders::Shader;
use nalgebra::Vector3;

use super::Gpu;
use super::batch::BatchSize;
use super::forward::{Purpose, check_columns};
use super::kernel::GROUP;
use super::nets::Nets;
use super::record::dispatch;
use super::session::GpuSession;
use super::testing::{advance, gpu, on_gpu, own_gpu, settled, upload};
use super::weights::layers;
use marf_field::test_scene::{ball, ball_view, psnr, small};
use marf_field::training::Training;
use marf_field::{
    Background, Config, Device, Field, FieldError, Gain, GpuError, Pixels, Trainer, View, ViewDependence,
};

/// Between two trainings that round differently, after few steps on few small photos.
const CLOSE_DB: f64 = 0.3;
/// The same where sparse points pull: after 120 steps the GPU was 0.1 to 0.5 dB behind the CPU for each of four seeds, in 0.1.0
/// as well. Why is not known.
const CLOSE_WITH_POINTS_DB: f64 = 0.6;

fn lost<T>(of: Result<T, FieldError>) -> bool {
    let text = of.as_ref().err().map(ToString::to_string).unwrap_or_default();
    matches!(of, Err(FieldError::Gpu(GpuError::Lost { .. })))
        && text.ends_with("Run again to continue from the last checkpoint, or use `device = \"cpu\"`")
}

#[test]
fn a_lost_device_is_an_error_with_advice_wherever_it_is_met() {
    let Some(gpu) = own_gpu("a_lost_device_is_an_error_with_advice_wherever_it_is_met").map(Arc::new) else {
        return;
    };
    let mut trainer = on_gpu(&gpu, ball(2, 8), &[], &small(), 1);
    advance(&mut trainer, 3);
    let good = trainer.save().unwrap();
    let view = ball_view(0.5, 0.0, 8);
    let field = trainer.field().unwrap();
    let numbers = gpu.filled("numbers", &[1_u32; 8]).unwrap();
    let layers = layers(&trainer.training.state.weights);
    let nets = Nets::new(&gpu, &layers).unwrap();
    gpu.device.destroy();
    assert!(lost(trainer.advance(5)));
    assert_eq!(trainer.steps(), 3);
    assert!(lost(trainer.save()));
    assert!(lost(trainer.field()));
    assert!(lost(field.render(&view.camera, &view.cam_from_world)));
    assert!(lost(trainer.restore(&good)));
    assert!(lost(Field::new(field.model.clone(), gpu.clone())));
    // Whatever is done with a lost device, nothing panics.
    gpu.write(&numbers, 2, &[7_u32]);
    for made in [
        gpu.zeros::<u32>("more", 8),
        gpu.uniform("one", 1_u32),
        gpu.filled("none", &[]),
    ] {
        assert!(matches!(made, Err(GpuError::Lost { .. })));
    }
    assert!(matches!(gpu.read(&numbers), Err(GpuError::Lost { .. })));
    assert!(matches!(gpu.wait(), Err(GpuError::Lost { .. })));
    assert!(Nets::new(&gpu, &layers).is_err());
    gpu.submit(|_| {});
    drop((nets, trainer, field));
}

#[test]
fn a_device_that_is_lost_before_the_first_step_is_an_error_too() {
    let test = "a_device_that_is_lost_before_the_first_step_is_an_error_too";
    let Some(gpu) = own_gpu(test).map(Arc::new) else {
        return;
    };
    let shader = Shader {
        name: "copy",
        shared: &[],
        text: "@group(0) @binding(0) var<storage, read> source: array<u32>;
@group(0) @binding(1) var<storage, read_write> copied: array<u32>;
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) { copied[id.x] = source[id.x]; }",
        heads: &[],
    };
    let kernel = gpu.kernel(&shader, "").unwrap();
    let arrays = [[0_u32; 4]; 2].map(|values| gpu.filled("numbers", &values).unwrap());
    gpu.device.destroy();
    let parts = arrays.each_ref().map(Into::into);
    let work = dispatch(&gpu, &kernel, &parts, [GROUP, 1, 1]);
    gpu.submit(|recorder| work.record(recorder));
    assert!(gpu.wait().is_err());
    let mut training = Training::new(ball(2, 8), &[], &small(), 1).unwrap();
    assert!(GpuSession::new(&gpu, &mut training).is_err());
}

#[test]
fn columns_beyond_a_binding_are_refused_with_both_numbers() {
    let Some(mut gpu) = own_gpu("columns_beyond_a_binding_are_refused_with_both_numbers") else {
        return;
    };
    let config = Config {
        batch_samples: 4096,
        color_width: 128,
        color_layers: 2,
        ..small()
    };
    let mut training = Training::new(ball(2, 8), &[], &config, 0).unwrap();
    let weights = &training.state.weights;
    let size = BatchSize {
        samples: 2 * 4096,
        rays: 4096,
    };
    // What the workgroups of the way back keep is more than any column.
    let needed = 4 * layers(weights).work(size.samples, size.rays) as u64;
    assert!(needed > 64 * 4 * size.samples as u64);
    gpu.limits.max_storage_buffer_binding_size = needed;
    assert_eq!(check_columns(&gpu, weights, size, Purpose::Training), Ok(()));
    gpu.limits.max_storage_buffer_binding_size = needed - 1;
    let adapter = gpu.name().to_owned();
    let refused = GpuSession::new(&Arc::new(gpu), &mut training).err();
    let text = refused.map(|error| error.to_string()).unwrap_or_default();
    let offered = needed - 1;
    assert_eq!(
        text,
        format!(
            "`{adapter}` offers {offered} max_storage_buffer_binding_size, {needed} are needed: lower `batch_samples` \
             or the widths of the networks"
        )
    );
}

/// Mean over the views.
fn mean(field: &Field, views: &[View]) -> f64 {
    views.iter().map(|view| psnr(field, view)).sum::<f64>() / views.len() as f64
}

/// Returns a training on the device and the same on the CPU.
fn both(gpu: &Arc<Gpu>, views: Vec<View>, points: &[[f64; 3]], config: &Config) -> [Trainer; 2] {
    let there = on_gpu(gpu, views.clone(), points, config, 3);
    [there, Trainer::new(views, points, config, 3).unwrap()]
}

/// Trains on the device and on the CPU: both reach nearly the same PSNR on their views, in pictures of the CPU.
/// Returns both trainers, without the device.
fn close(name: &str, trainers: [Trainer; 2], steps: u64, most_db: f64) -> [Trainer; 2] {
    let mut trainers = trainers.map(|mut trainer| {
        advance(&mut trainer, steps);
        trainer.with_backend(crate::open(&Device::Cpu).unwrap()).unwrap()
    });
    let [there, here] = trainers
        .each_mut()
        .map(|trainer| mean(&trainer.field().unwrap(), &trainer.training.views));
    println!("{name}, {steps} steps: {there:.2} dB on the GPU, {here:.2} dB on the CPU");
    assert!(
        (there - here).abs() < most_db,
        "{name}: {there} dB, on the CPU {here} dB"
    );
    trainers
}

#[test]
fn every_shape_of_a_field_learns_as_on_the_cpu() {
    let Some(gpu) = gpu("every_shape_of_a_field_learns_as_on_the_cpu") else {
        return;
    };
    let two = Config {
        features: 2,
        levels: Some(8),
        color_layers: 2,
        gain: Gain::Off,
        ..small()
    };
    // Of the four levels only the first is dense: 9^3 corners.
    let hashed = Config {
        log2_table: Some(10),
        color_layers: 3,
        density_width: 32,
        gain: Gain::PerPhotoAndOffset,
        ..small()
    };
    let plain = Config {
        view_dependence: ViewDependence::Off,
        background: Background::Black,
        color_width: 32,
        ..small()
    };
    for (name, config) in [("two features", two), ("hashed", hashed), ("plain", plain)] {
        let [there, _] = close(name, both(&gpu, ball(4, 12), &[], &config), 48, CLOSE_DB);
        let dense = there
            .training
            .state
            .weights
            .shapes
            .iter()
            .filter(|shape| shape.dense)
            .count();
        assert!(name != "hashed" || dense == 1, "{dense} dense levels");
    }
}

#[test]
fn photos_of_all_kinds_learn_as_on_the_cpu() {
    let Some(gpu) = gpu("photos_of_all_kinds_learn_as_on_the_cpu") else {
        return;
    };
    let mut sizes = ball(3, 12);
    sizes.push(ball_view(0.7, 0.2, 20));
    let thinned = (0..4_u32).map(|index| {
        let view = ball_view(f64::from(index) * 1.5, 0.3, 16);
        let photo = Image::from_fn(16, 16, |x, y| view.image.pixels[(16 * y + x) as usize]);
        View {
            image: Pixels::thinned(photo, None, 7, 5, u64::from(index)),
            ..view
        }
    });
    let thinned: Vec<View> = thinned.collect();
    let kept: usize = thinned.iter().map(|view| view.image.count()).sum();
    assert_eq!(kept, 4 * 256_usize.div_ceil(7));
    let one = |value: u8, width| {
        let mut views = ball(1, width);
        views[0].image.pixels.fill([value; 3]);
        views
    };
    for (name, views) in [
        ("sizes", sizes),
        ("one pixel", one(128, 1)),
        ("black", one(0, 8)),
        ("white", one(255, 8)),
    ] {
        close(name, both(&gpu, views, &[], &small()), 30, CLOSE_DB);
    }
    // Photos with one pixel in 7 kept are not pictures to compare with.
    let mut there = on_gpu(&gpu, thinned.clone(), &[], &small(), 3);
    let mut here = Trainer::new(thinned, &[], &small(), 3).unwrap();
    let found = [settled(&mut there, 1).unwrap(), here.advance(1).unwrap()];
    let [on_gpu, on_cpu] = found.map(|step| step.loss);
    assert!(
        (on_gpu - on_cpu).abs() < 1e-5 * on_cpu,
        "thinned: {on_gpu} {on_cpu}"
    );
    advance(&mut there, 30);
}

/// Points on the ball of radius 1.
fn points() -> Vec<[f64; 3]> {
    let point = |index: u32| {
        let (angle, up) = (f64::from(index) * 2.4, f64::from(index) / 32.0 - 1.0);
        let out = (1.0 - up * up).sqrt();
        [out * angle.cos(), out * angle.sin(), up]
    };
    (0..64).map(point).collect()
}

#[test]
fn points_pull_and_steps_along_rays_are_halved_as_on_the_cpu() {
    let Some(gpu) = gpu("points_pull_and_steps_along_rays_are_halved_as_on_the_cpu") else {
        return;
    };
    // Few steps a ray, so that they are halved at step 128.
    let config = Config {
        near: Some(0.5),
        far: Some(2.5),
        cone: 0.25,
        min_step: 0.4,
        halvings: Some(2),
        depth_weight: 0.03,
        depth_steps: Some(100),
        batch_samples: 512,
        ..small()
    };
    let trainers = both(&gpu, ball(4, 24), &points(), &config);
    let trainers = close("points", trainers, 140, CLOSE_WITH_POINTS_DB);
    for trainer in trainers {
        assert!(!trainer.training.observations.is_empty());
        assert_eq!(trainer.training.state.halvings, 1);
    }
}

#[test]
fn far_cameras_and_near_at_far_train_on_a_device() {
    let Some(gpu) = gpu("far_cameras_and_near_at_far_train_on_a_device") else {
        return;
    };
    let far = |index: u32| {
        let angle = f64::from(index) * 1.5;
        let eye = Vector3::new(angle.cos(), angle.sin(), 0.2) * 1e5;
        View {
            id: format!("far {index}"),
            camera: Camera::pinhole(12, 12, 6e5),
            cam_from_world: Pose::looking_at(eye, Vector3::zeros(), -Vector3::z()),
            image: Image::from_fn(12, 12, |x, y| [(x * 20) as u8, (y * 20) as u8, 90]).into(),
            distances: Vec::new(),
        }
    };
    let trainers = both(&gpu, (0..2).map(far).collect(), &points(), &small());
    close("far", trainers, 20, CLOSE_WITH_POINTS_DB);
    let config = Config {
        near: Some(1.0),
        far: Some(1.0 + f64::EPSILON),
        ..small()
    };
    let mut there = on_gpu(&gpu, ball(2, 8), &[], &config, 0);
    let step = settled(&mut there, 4).unwrap();
    assert!(
        step.rays > 0 && step.loss.is_finite(),
        "near 1, far 1 + 2^-52: {step:?}"
    );
}

#[test]
fn numbers_that_run_away_stop_by_name_and_leave_the_state_before_the_step() {
    let test = "numbers_that_run_away_stop_by_name_and_leave_the_state_before_the_step";
    let Some(gpu) = gpu(test) else {
        return;
    };
    let mut trainer = on_gpu(&gpu, ball(3, 12), &[], &small(), 2);
    advance(&mut trainer, 5);
    let good = trainer.save().unwrap();
    for tensor in ["table.0", "density.1", "color.0", "background"] {
        trainer.restore(&good).unwrap();
        let mut tensors = trainer.training.state.weights.tensors_mut();
        let found = tensors.iter_mut().find(|(name, _)| name == tensor);
        found.unwrap().1.fill(1e30);
        drop(tensors);
        upload(&mut trainer);
        let planted = trainer.save().unwrap();
        let text = settled(&mut trainer, 5).unwrap_err().to_string();
        assert!(
            text.starts_with("step 5: `") && text.ends_with("lower `learning_rate` (now 0.02)"),
            "{tensor}: {text}"
        );
        assert!(trainer.save().unwrap() == planted, "{tensor}: changed");
    }
    trainer.restore(&good).unwrap();
    advance(&mut trainer, 8);
}

#[test]
fn a_rate_that_is_too_high_stops_by_name_and_leaves_a_state_that_can_be_taken_back() {
    let test = "a_rate_that_is_too_high_stops_by_name_and_leaves_a_state_that_can_be_taken_back";
    let Some(gpu) = gpu(test) else {
        return;
    };
    let trainer = || {
        let mut trainer = on_gpu(&gpu, ball(3, 12), &[], &small(), 2);
        trainer.training.config.learning_rate = 1e6;
        trainer
    };
    let mut stopped = trainer();
    let refused = loop {
        match stopped.advance(50) {
            Ok(step) => assert!(step.loss.is_finite() && stopped.steps() < 50, "{step:?}"),
            Err(error) => break error,
        }
    };
    let step = stopped.steps();
    assert!(
        matches!(refused, FieldError::NotFinite { step: named, .. } if named == step),
        "{refused}"
    );
    // As a training that ends there.
    let mut before = trainer();
    advance(&mut before, step);
    let saved = stopped.save().unwrap();
    assert!(saved == before.save().unwrap(), "changed by step {step}");
    assert_eq!(stopped.restore(&saved), Ok(()));
}

/// A driver that resets its device causes an error in a training. On the device opened again, the same
/// training continues from its last checkpoint to the bytes that it would have had.
#[test]
fn a_training_whose_device_is_lost_goes_on_from_its_checkpoint_to_the_same_bytes() {
    let name = "a_training_whose_device_is_lost_goes_on_from_its_checkpoint_to_the_same_bytes";
    let Some(first) = own_gpu(name).map(Arc::new) else {
        return;
    };
    let second = own_gpu(name).map(Arc::new).unwrap();
    let begun = |gpu: &Arc<Gpu>| on_gpu(gpu, ball(4, 16), &[], &small(), 7);
    let mut whole = begun(&second);
    advance(&mut whole, 60);
    let mut broken = begun(&first);
    advance(&mut broken, 32);
    let kept = broken.save().unwrap();
    advance(&mut broken, 40);
    first.device.destroy();
    assert!(lost(broken.advance(20)));
    assert!(lost(broken.save()));
    // Nothing new can be made of it. It opens again.
    assert!(lost(Trainer::from_training(
        Training::new(ball(4, 16), &[], &small(), 7).unwrap(),
        first.clone()
    )));
    let mut resumed = begun(&second);
    resumed.restore(&kept).unwrap();
    assert_eq!(resumed.steps(), 32);
    advance(&mut resumed, 60);
    assert!(whole.save().unwrap() == resumed.save().unwrap());
}

#[test]
fn a_shared_device_that_was_lost_is_opened_anew() {
    let name = "a_shared_device_that_was_lost_is_opened_anew";
    let Some(own) = own_gpu(name) else {
        return;
    };
    // A name of its own, so that no other test shares the device.
    let wanted = Device::Gpu(Some(own.name().to_uppercase()));
    let first = Gpu::shared(&wanted).unwrap().unwrap();
    let again = Gpu::shared(&wanted).unwrap().unwrap();
    assert!(Arc::ptr_eq(&first, &again));
    first.device.destroy();
    assert!(first.wait().is_err());
    let second = Gpu::shared(&wanted).unwrap().unwrap();
    assert!(!Arc::ptr_eq(&first, &second));
    assert_eq!((second.wait(), second.id()), (Ok(()), first.id()));
}
