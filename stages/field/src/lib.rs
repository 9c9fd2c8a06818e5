//! The radiance field: a multiresolution hash grid and two small networks, trained and rendered on the CPU.
//!
//! Room rule: it knows scenes (photos, cameras, poses), no stage and no file system. Bytes come in, bytes go out.
//! Invariant: the same views, points, config and seed give the same weights, bit for bit, for any number of
//! threads and any instruction set; no result holds a number that is not finite.

mod background;
mod bands;
mod batch;
mod checkpoint;
mod config;
mod cpu;
mod depth;
mod error;
mod exposure;
#[cfg(test)]
mod extreme_tests;
mod facts;
mod footprint;
mod frame;
mod gpu;
mod learn;
mod model;
mod occupancy;
mod overrides;
mod pixels;
mod quality;
mod render;
mod rng;
#[cfg(test)]
mod rover_tests;
mod sh;
mod shade;
mod size;
#[cfg(test)]
mod size_tests;
mod tensors;
mod trainer;
#[cfg(test)]
mod training_tests;
mod views;
mod weights;

pub use bands::render_in_bands;
pub use config::{Background, Config, Gain, Occupied, ViewDependence};
pub use error::FieldError;
pub use facts::{Facts, LevelFacts, Trial};
pub use footprint::{decoding_bytes, judging_bytes, training_bytes};
pub use gpu::{Device, DeviceError, Gpu, GpuError};
pub use model::Field;
pub use overrides::{OverrideError, Overrides};
pub use pixels::Pixels;
pub use quality::{EXPECTED_STEPS_PER_S, Quality};
pub use render::Render;
pub use size::{Chosen, Sizes};
pub use trainer::{Step, Trainer};
pub use views::View;

/// The kernels, for `cargo bench` alone: no part of the interface.
#[doc(hidden)]
pub mod bench {
    pub use crate::cpu::{adam, composite, encode, gemm, march, math, net, simd};
    pub use crate::gpu::{Ceilings, KernelTime, Load, Timed, ceilings, time_steps};
}
