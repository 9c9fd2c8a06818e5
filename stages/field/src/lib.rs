//! The radiance field: a multiresolution hash grid and two small networks, trained and rendered on the CPU or another backend.
//!
//! It knows scenes (photos, cameras, poses), no stage and no file system. Bytes come in, bytes go out.
//! Invariant: the same views, points, config and seed give the same weights, bit for bit, for any number of
//! threads and any instruction set. No result holds a number that is not finite.

pub mod backend;
mod background;
mod bands;
pub mod batch;
mod checkpoint;
mod config;
pub mod cpu;
mod cpu_backend;
#[cfg(test)]
mod degenerate_tests;
pub mod depth;
mod derived;
mod device;
mod distances;
pub mod draw;
mod error;
pub mod exposure;
#[cfg(test)]
mod extreme_tests;
mod facts;
mod field;
mod footprint;
pub mod frame;
mod gpu_error;
pub mod learn;
mod losses;
pub mod model;
pub mod occupancy;
mod overrides;
mod pace;
mod photo_history;
mod picture;
pub mod pixels;
pub mod planes;
mod quality;
mod rates;
pub mod render;
pub mod rng;
#[cfg(test)]
mod rover_tests;
pub mod schedule;
mod seen;
pub mod sh;
pub mod shade;
mod size;
#[cfg(test)]
mod size_keys_tests;
#[cfg(test)]
mod size_tests;
pub mod state;
mod surface;
mod tensors;
#[cfg(any(test, feature = "test-scene"))]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]
pub mod test_scene;
mod trainer;
pub mod training;
#[cfg(test)]
mod training_properties;
#[cfg(test)]
mod training_tests;
mod views;
mod warm_start;
pub mod weights;

pub use backend::Step;
pub use bands::render_in_bands;
pub use config::{Background, Config, DepthSource, Occupied, ViewDependence};
pub use cpu_backend::Cpu;
pub use derived::Derived;
pub use device::{Device, DeviceError};
pub use error::FieldError;
pub use exposure::{Gain, Vignetting};
pub use facts::{Facts, LevelFacts};
pub use field::Field;
pub use footprint::{decoding_bytes, judging_bytes, training_bytes};
pub use gpu_error::GpuError;
pub use overrides::{OverrideError, Overrides};
pub use pace::{EXPECTED_STEPS_PER_S, OpenSizes, Pace, Pilot, steps_in};
pub use photo_history::{PhotoHistory, PhotoRecord};
pub use picture::Render;
pub use pixels::Pixels;
pub use quality::Quality;
pub use schedule::{STEPS_A_HALVING, Schedule, ScheduleError};
pub use size::{Choice, FEW_PHOTOS, Sizes};
pub use trainer::Trainer;
pub use views::{PixelDistance, View};
