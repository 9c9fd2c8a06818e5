//! Rendering within core WebGPU: no feature, and of every limit what any browser has.

use std::sync::Arc;

use super::Gpu;
use super::testing::{advance, gpu, own_gpu_within};
use marf_field::test_scene::{ball, small};
use marf_field::{Background, Config, Field, Trainer, ViewDependence};

/// The limits that every implementation of WebGPU has (W3C, WebGPU, 3.6.2): 8 storage buffers a stage,
/// bindings of 128 MiB, buffers of 256 MiB, workgroups of 256 threads and 16 KiB, 65,535 workgroups an axis.
fn core() -> wgpu::Limits {
    let limits = wgpu::Limits::default();
    assert_eq!(limits.max_storage_buffers_per_shader_stage, 8);
    assert_eq!(limits.max_storage_buffer_binding_size, 128 << 20);
    assert_eq!(limits.max_compute_workgroup_storage_size, 16 << 10);
    assert_eq!(limits.max_compute_invocations_per_workgroup, 256);
    limits
}

/// A device refuses the layout of a kernel that binds more than its limits say, so one that renders at these limits has
/// read them all.
#[test]
fn every_field_is_rendered_within_the_limits_of_a_browser_with_the_same_bits() {
    let name = "every_field_is_rendered_within_the_limits_of_a_browser_with_the_same_bits";
    let Some(least) = own_gpu_within(name, &core()).map(Arc::new) else {
        return;
    };
    let most = gpu(name).unwrap();
    let two = Config {
        features: 2,
        levels: Some(8),
        color_layers: 3,
        ..small()
    };
    let plain = Config {
        view_dependence: ViewDependence::Off,
        background: Background::Black,
        ..small()
    };
    for config in [small(), two, plain] {
        let views = ball(4, 16);
        let mut trainer = Trainer::new(views.clone(), &[], &config, 1).unwrap();
        advance(&mut trainer, 40);
        let here = trainer.field().unwrap();
        let [found, expected] = [&least, &most].map(|gpu: &Arc<Gpu>| {
            let field = Field::new(here.model.clone(), gpu.clone()).unwrap();
            field.render(&views[1].camera, &views[1].cam_from_world).unwrap()
        });
        assert!(found.opacity.iter().any(|opacity| *opacity > 0.0));
        assert!(found == expected, "{config:?}");
    }
}
