//! A scene and parameters to a trained field, its metrics and its pictures.
//!
//! Four stages: `train`, `pace` (turns a budget into steps), `evaluate` and `render`. Invariant: what a node
//! answers depends on photos, cameras, parameters and seed; the clock decides only when a checkpoint is kept,
//! and, in `pace` alone, how many steps a budget buys on this machine.

mod error;
mod evaluate;
mod fit;
mod judge;
mod memory;
mod pace;
mod params;
mod render;
mod split;
mod train;
mod trials;

pub use error::TrainError;
pub use evaluate::Evaluate;
pub use pace::Pace;
pub use render::Render;
pub use train::Train;
