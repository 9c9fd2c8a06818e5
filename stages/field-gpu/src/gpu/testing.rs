//! What the tests of kernels and trainings share: an adapter, which they skip by name without, and trainings on it.

use std::sync::Arc;

use super::Gpu;
use marf_field::draw::Target;
use marf_field::rng::{Purpose, random_numbers};
use marf_field::training::Training;
use marf_field::{Config, Device, FieldError, GpuError, Step, Trainer, View};

/// Returns the adapter that tests run on: `MARF_TEST_GPU` (`gpu`, `gpu:NAME` or a part of its name), or
/// llvmpipe. Also returns whether the variable is set.
fn wanted() -> (Device, bool) {
    let named = |name: String| Device::Gpu(Some(name));
    match std::env::var("MARF_TEST_GPU") {
        Ok(asked) => (asked.parse().unwrap_or(named(asked)), true),
        Err(_) => (named("llvmpipe".to_owned()), false),
    }
}

fn opened<T>(test: &str, open: impl Fn(&Device) -> Result<Option<T>, GpuError>) -> Option<T> {
    let (device, is_asked) = wanted();
    let opened = open(&device);
    assert!(!matches!(opened, Ok(None)), "MARF_TEST_GPU={device} is no GPU");
    if let Err(error) = &opened {
        assert!(!is_asked, "{error}");
        eprintln!("{test}: skipped, no software adapter (install mesa-vulkan-drivers): {error}");
    }
    opened.ok().flatten()
}

/// Returns a target as kernels see it.
pub fn aim(target: &Target) -> marf_shaders::Target {
    marf_shaders::Target {
        rgb: target.rgb,
        view: target.view,
        behind: target.behind.map_or([0.0; 3], |behind| behind.rgb),
        share: target.behind.map_or(-1.0, |behind| behind.share),
    }
}

/// Opens the adapter that tests run on, once for all of them.
///
/// Without one the test says so and is passed over, unless `MARF_TEST_GPU` asks for it.
pub fn gpu(test: &str) -> Option<Arc<Gpu>> {
    opened(test, Gpu::shared)
}

/// Opens, as [`gpu`] does, a device of the test's own, which it may change or lose.
pub fn own_gpu(test: &str) -> Option<Gpu> {
    opened(test, Gpu::open)
}

/// Opens, as [`own_gpu`] does, a device that has these limits and no feature.
pub fn own_gpu_within(test: &str, limits: &wgpu::Limits) -> Option<Gpu> {
    opened(test, |device| Gpu::open_within(device, Some(limits.clone())))
}

/// Makes a training on a device. Sparse points and seed are as on the CPU.
pub fn on_gpu(gpu: &Arc<Gpu>, views: Vec<View>, points: &[[f64; 3]], config: &Config, seed: u64) -> Trainer {
    let training = Training::new(views, points, config, seed).unwrap();
    Trainer::from_training(training, gpu.clone()).unwrap()
}

/// Trains up to a step.
pub fn advance(trainer: &mut Trainer, to: u64) {
    while trainer.steps() < to {
        trainer.advance(to - trainer.steps()).unwrap();
    }
}

/// Takes at most `most` steps and returns their result, with that of those before.
pub fn settled(trainer: &mut Trainer, most: u64) -> Result<Step, FieldError> {
    let told = trainer.advance(most)?;
    Ok(told.and(trainer.settle()?))
}

/// Copies the state that the trainer holds to the device.
pub fn upload(trainer: &mut Trainer) {
    trainer.session.upload(&trainer.training).unwrap();
}

/// Returns the largest difference, and where.
pub fn worst(found: &[f32], expected: &[f32]) -> (f32, usize) {
    assert_eq!(found.len(), expected.len());
    let pairs = found.iter().zip(expected).enumerate();
    pairs.fold((0.0, 0), |worst, (index, (found, expected))| {
        let apart = (found - expected).abs();
        // Not less or equal: NaN is worst.
        if apart <= worst.0 { worst } else { (apart, index) }
    })
}

/// Returns random numbers in [-1, 1).
pub fn numbers(len: usize, stream: u64) -> Vec<f32> {
    let mut rng = random_numbers(13, Purpose::Rays, 0, stream);
    (0..len).map(|_| rng.unit_f32() * 2.0 - 1.0).collect()
}
