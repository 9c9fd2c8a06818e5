//! The radiance field: a multiresolution hash grid and two small networks, trained and rendered on the CPU or a GPU.
//!
//! It knows scenes (photos, cameras, poses), no stage and no file system. Bytes come in, bytes go out.
//! Invariant: the same views, points, config and seed give the same weights, bit for bit, for any number of
//! threads and any instruction set; no result holds a number that is not finite.

mod backend;
mod background;
mod bands;
mod batch;
mod checkpoint;
mod config;
mod cpu;
mod cpu_backend;
mod depth;
mod derived;
mod device;
mod distances;
mod draw;
mod error;
mod exposure;
#[cfg(test)]
mod extreme_tests;
mod facts;
mod field;
mod footprint;
mod frame;
#[cfg(feature = "gpu")]
mod gpu;
mod gpu_error;
mod learn;
mod learnt;
mod losses;
mod model;
mod occupancy;
mod open;
mod overrides;
mod pace;
mod picture;
mod pixels;
mod quality;
mod render;
mod rng;
#[cfg(test)]
mod rover_tests;
mod schedule;
mod seen;
mod sh;
mod shade;
mod size;
#[cfg(test)]
mod size_tests;
mod state;
mod surface;
mod tensors;
#[cfg(test)]
mod test_scene;
mod trainer;
mod training;
#[cfg(test)]
mod training_properties;
#[cfg(test)]
mod training_tests;
mod views;
mod watch;
mod weights;

pub use backend::Step;
pub use bands::render_in_bands;
pub use config::{Background, Config, Gain, Occupied, ViewDependence};
pub use derived::Derived;
pub use device::{Device, DeviceError};
pub use error::FieldError;
pub use facts::{Facts, LevelFacts, Trial};
pub use field::Field;
pub use footprint::{decoding_bytes, judging_bytes, training_bytes};
pub use gpu_error::GpuError;
pub use learnt::{Learnt, LearntPhoto};
pub use overrides::{OverrideError, Overrides};
pub use pace::{EXPECTED_STEPS_PER_S, Pace};
pub use picture::Render;
pub use pixels::Pixels;
pub use quality::Quality;

pub use schedule::{STEPS_A_HALVING, Schedule, ScheduleError};
pub use size::{Chosen, Sizes};
pub use trainer::Trainer;
pub use views::View;

/// The kernels, for `cargo bench` alone: no part of the interface.
#[doc(hidden)]
pub mod bench {
    pub use crate::cpu::{adam, clearance, composite, encode, gemm, march, math, net, simd};
    pub use crate::cpu_backend::{Counts, Watched, WatchedTraining};
    #[cfg(feature = "gpu")]
    pub use crate::gpu::{
        Ceilings, Cost, Filled, Gpu, KernelTime, Load, Shape, Timed, TimedTraining, ceilings,
    };
    pub use crate::watch::{PARTS, Part};
}
