//! `marf bench`: figures about this program, measured on the machine at hand.

mod child;
mod engine;
mod faults;
mod items;
mod pictures;
mod train;

pub use engine::engine;
pub use faults::faults;
pub use items::items;
pub use train::train;
