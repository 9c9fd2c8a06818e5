//! `train`: a scene to a trained field, measured on held-out photos. `partial`: its first steps.

mod log;
mod partial;
mod photo_set;
mod pilot;
mod plan;
mod planner;
mod setup;
mod stage;
mod start;
mod trained_field;
mod training;
mod training_loop;

pub use partial::Partial;
pub use stage::Train;
