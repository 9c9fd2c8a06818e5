//! The memory of a training: counted before it is taken, refused by the key, within the limits of small devices.

use std::sync::Arc;

use super::Gpu;
use super::memory::MemoryNeed;
use super::session::GpuSession;
use super::testing::{advance, gpu, on_gpu, own_gpu, own_gpu_within};
use marf_field::test_scene::{ball, small};
use marf_field::training::Training;
use marf_field::{Config, FieldError, Gain, GpuError};

/// Uniforms of kernels are made when these are bound, and not counted: fewer than this many bytes.
const UNIFORMS: u64 = 1 << 16;

fn training(config: &Config) -> Training {
    Training::new(ball(4, 16), &[], config, 0).unwrap()
}

fn refused(gpu: Gpu, config: &Config) -> GpuError {
    match GpuSession::new(&Arc::new(gpu), &mut training(config)).err() {
        Some(FieldError::Gpu(error)) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_is_counted_beforehand_is_what_is_taken() {
    let Some(gpu) = own_gpu("what_is_counted_beforehand_is_what_is_taken").map(Arc::new) else {
        return;
    };
    let two = Config {
        features: 2,
        levels: Some(8),
        log2_table: Some(14),
        color_layers: 3,
        ..small()
    };
    let large = Config {
        batch_samples: 1 << 14,
        gain: Gain::PerPhotoAndOffset,
        ..small()
    };
    for config in [small(), two, large] {
        let mut training = training(&config);
        let needed = MemoryNeed::count(&gpu, &training).unwrap();
        let before = gpu.taken();
        let _session = GpuSession::new(&gpu, &mut training).unwrap();
        let taken = gpu.taken() - before;
        println!("{needed:?}, taken {taken}");
        assert!(
            (needed.bytes..needed.bytes + UNIFORMS).contains(&taken),
            "{needed:?}, taken {taken}"
        );
        assert!(needed.tables + needed.photos < needed.bytes, "{needed:?}");
        assert!(needed.photos == 4 * 4 * 16 * 16, "{needed:?}");
    }
}

#[test]
fn a_training_that_does_not_fit_is_refused_with_both_numbers_and_the_key() {
    let name = "a_training_that_does_not_fit_is_refused_with_both_numbers_and_the_key";
    let batch = small();
    let tables = Config {
        log2_table: Some(20),
        finest_resolution: Some(1024),
        ..small()
    };
    for (config, key, of) in [
        (batch, "batch_samples", "samples of a step"),
        (tables, "log2_table", "tables"),
    ] {
        let Some(mut gpu) = own_gpu(name) else {
            return;
        };
        let needed = MemoryNeed::count(&gpu, &training(&config)).unwrap().bytes;
        gpu.planted_memory = Some(needed - 1);
        let error = refused(gpu, &config);
        let GpuError::TooLarge { share, .. } = &error else {
            panic!("{error}")
        };
        let text = error.to_string();
        let offered = needed - 1;
        let end = format!(
            "gives {offered} bytes, the training takes {needed}, {share} of them for {of}: lower `{key}`, or use `device = \"cpu\"`"
        );
        assert!(text.ends_with(&end), "{text}");
        // What is enough is taken.
        let mut gpu = own_gpu(name).unwrap();
        gpu.planted_memory = Some(needed);
        assert!(
            GpuSession::new(&Arc::new(gpu), &mut training(&config)).is_ok(),
            "{key}"
        );
    }
}

/// A step of 2^20 samples is counted, or one of its arrays refused, without taking a byte.
#[test]
fn the_largest_keys_are_refused_before_any_memory_is_taken() {
    let name = "the_largest_keys_are_refused_before_any_memory_is_taken";
    let Some(gpu) = own_gpu(name) else {
        return;
    };
    for config in [
        Config {
            batch_samples: 1 << 20,
            density_width: 128,
            color_width: 128,
            color_layers: 3,
            ..small()
        },
        Config {
            batch_samples: 1 << 20,
            ..small()
        },
    ] {
        let needed = MemoryNeed::count(&gpu, &training(&config));
        match needed {
            Ok(needed) => assert!(needed.bytes > 1 << 29, "{needed:?}"),
            Err(FieldError::Gpu(GpuError::Limit { needed, offered, .. })) => assert!(needed > offered),
            Err(error) => panic!("{error}"),
        }
        assert_eq!(gpu.taken(), 0);
    }
}

/// A table twice as large as 60 s of 100 M samples/s need, for the finest scene, and the largest field of the
/// bench.
#[test]
fn the_sizes_of_a_card_fit_4_gb_and_bindings_of_128_mb() {
    let Some(mut gpu) = own_gpu("the_sizes_of_a_card_fit_4_gb_and_bindings_of_128_mb") else {
        return;
    };
    gpu.limits.max_storage_buffer_binding_size = 128 << 20;
    gpu.limits.max_buffer_size = 1 << 30;
    let derived = Config {
        levels: Some(12),
        log2_table: Some(21),
        finest_resolution: Some(8192),
        batch_samples: 1 << 18,
        ..Config::default()
    };
    let fixed = Config {
        batch_samples: 1 << 18,
        ..Config::fixed()
    };
    for config in [derived, fixed] {
        let needed = MemoryNeed::count(&gpu, &training(&config)).unwrap();
        println!("{needed:?}");
        assert!(needed.bytes <= 4_000_000_000, "{needed:?}");
    }
}

#[test]
fn a_device_with_the_least_limits_trains_if_it_binds_eleven_buffers() {
    let name = "a_device_with_the_least_limits_trains_if_it_binds_eleven_buffers";
    let eleven = wgpu::Limits {
        max_storage_buffers_per_shader_stage: 11,
        ..wgpu::Limits::default()
    };
    let Some(there) = own_gpu_within(name, &eleven) else {
        return;
    };
    let mut least = on_gpu(&Arc::new(there), ball(4, 16), &[], &small(), 7);
    let whole = gpu(name).unwrap();
    let mut most = on_gpu(&whole, ball(4, 16), &[], &small(), 7);
    for trainer in [&mut least, &mut most] {
        advance(trainer, 8);
        trainer.sync().unwrap();
    }
    // Nothing else of what a device has decides a bit.
    assert!(least.training.state == most.training.state);
    let eight = own_gpu_within(name, &wgpu::Limits::default()).unwrap();
    let text = refused(eight, &small()).to_string();
    assert!(
        text.contains("offers 8 max_storage_buffers_per_shader_stage, 11 are needed"),
        "{text}"
    );
}
