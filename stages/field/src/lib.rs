//! The radiance field: a multiresolution hash grid and two small networks, trained and rendered on the CPU.
//!
//! Room rule: it knows scenes (photos, cameras, poses), no stage and no file system. Bytes come in, bytes go out.
//! Invariant: the same views, points, config and seed give the same weights, bit for bit, for any number of
//! threads and any instruction set; no result holds a number that is not finite.

mod bands;
mod batch;
mod checkpoint;
mod config;
mod cpu;
mod depth;
mod error;
mod exposure;
mod facts;
mod frame;
mod learn;
mod model;
mod occupancy;
mod overrides;
mod quality;
mod render;
mod rng;
#[cfg(test)]
mod rover_tests;
mod sh;
mod shade;
mod tensors;
mod trainer;
#[cfg(test)]
mod training_tests;
mod views;
mod weights;

pub use bands::render_in_bands;
pub use config::{Background, Config, Gain, Occupied};
pub use error::FieldError;
pub use facts::{Facts, LevelFacts};
pub use model::Field;
pub use overrides::{OverrideError, Overrides};
pub use quality::Quality;
pub use render::Render;
pub use trainer::{Step, Trainer};
pub use views::View;
