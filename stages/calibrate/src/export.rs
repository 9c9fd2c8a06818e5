//! A scene in the formats of other programs: transforms.json, COLMAP's model, PLY.

mod colmap;
mod ply;
mod tracks;
mod transforms;

pub use colmap::{write_colmap, write_colmap_text};
pub use ply::write_ply;
pub use tracks::{Observation, TrackPoint, Tracks};
pub use transforms::{beside, write_transforms};
