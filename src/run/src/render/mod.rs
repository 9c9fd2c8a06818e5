//! Pictures and films of trained fields.

mod path;
mod pictures;
mod size;

pub use pictures::{FILM, RenderRequest, RenderResult, render};
pub use size::SizeRequest;
