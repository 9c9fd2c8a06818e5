//! The filters: each photo is kept or rejected, with the score and the reason.
//!
//! A filter is a file of this folder that implements [`Filter`], declared by `mod`, and one row of the `filters!`
//! table in `survey.rs`. Its section in pipeline.toml, its help text, its keys and its place in `marf filter` come
//! from there. All filters measure a photo together, from one decode. The engine keeps the measures of each filter in
//! a table of its own. Decisions by thresholds are cheap and always made again. Invariant: no verdict depends on the
//! order of the photos, and no threshold changes a measure.

mod blur;
mod by_hand;
mod bytes;
mod candidates;
mod decision;
mod decoded;
mod descriptor;
mod duplicate;
mod facts;
mod filter;
mod grayscale;
#[cfg(test)]
mod guard;
mod hash;
mod histogram;
mod kept;
mod luma;
mod octave;
mod relation;
mod section;
mod shape;
mod similarity;
mod size;
mod stage;
mod statistics;
mod survey;
mod tones;

#[cfg(test)]
extern crate self as marf_filter;
/// The photos of the integration tests.
#[cfg(test)]
#[path = "../tests/common/mod.rs"]
mod common;

pub use by_hand::ByHand;
pub use decision::{DECODE, Decision};
pub use decoded::DecodedPhoto;
pub use facts::Facts;
pub use filter::{AnyPass, Contexts, Filter, MeasuredPhoto, Pass};
pub use luma::Luma;
pub use stage::FilterStage;
pub use survey::{STAGES, measure_photo, tables};
