//! PLY: a header that describes records, and the records as text or as little-endian bytes.
//!
//! Format: Greg Turk, The PLY Polygon File Format, 1994.

mod read;
mod write;

pub use read::{PlyError, read_points};
pub use write::{HeaderWriter, push_float};
