//! Readers of NASA's archives of rover photos: labels (ODL, PDS3, PDS4, VICAR, records of the raw-image feeds),
//! arrays of pixels, product names, and folder pages.
//!
//! Every reader takes bytes and returns typed values: no file, network, clock or random number is used. The bytes are
//! not trusted: each reader bounds the memory it takes, and returns an error for unreadable bytes.

mod camera;
mod companding;
pub mod dat;
mod demosaic;
mod describe;
pub mod exif;
pub mod feed;
mod fit;
#[doc(hidden)]
pub mod fuzzing;
mod label;
pub mod listing;
mod names;
mod odl;
mod pds3;
pub mod pds4;
mod pixels;
pub mod ranges;
pub mod raw;
mod sensor;
mod sun;
#[cfg(test)]
mod testing;
mod tone;
mod units;
pub mod values;
mod vicar;

pub use label::{BayerPhase, FileFacts, Label};
pub use names::{ProductName, Scheme, join_key};
pub use tone::WHITE_RADIANCE;
