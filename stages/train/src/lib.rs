//! Trained fields: search of parameters, training, evaluation, renders and uncertainty maps.
//!
//! Eight stages: `tune`, `train`, `partial` (the first steps of a training), `folds` (judges scenes of few photos), `evaluate`, `render`,
//! `bootstrap` and `video`. They share how photos are read, split, scored and written.
//!
//! Invariant: results depend on photos, cameras, parameters and seed. The clock decides only when a checkpoint is kept and, with a budget,
//! the schedule of a training, which the setup then holds. Held-out photos never reach a training step.

mod bootstrap;
mod checkpoint;
mod child;
mod depth_views;
mod error;
mod evaluate;
mod folds;
mod io;
mod memory;
mod photos;
mod random;
mod render;
mod scaled_photo;
mod scoring;
mod settings;
mod split;
mod train;
mod tune;
mod video;
mod view;
mod views;

pub use bootstrap::Bootstrap;
pub use error::TrainError;
pub use evaluate::Evaluate;
pub use folds::Folds;
pub use render::Render;
pub use train::{Partial, Train};
pub use tune::Tune;
pub use video::Video;
