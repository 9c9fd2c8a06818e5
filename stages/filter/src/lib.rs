//! The filters: each photo is kept or rejected, with the score and the reason.
//!
//! A filter is a file of this folder that implements [`Filter`], declared by `mod`, and one row of the `filters!` table
//! below. Its section in pipeline.toml, its help text, its keys and its place in `marf filter` come from there. All
//! filters measure a photo together, from one decode, and the engine keeps the measures, each filter's in a table of its
//! own; decisions by thresholds are cheap and always made again. Invariant: no verdict depends on the order of the photos,
//! and no threshold changes a measure.

mod blur;
mod by_hand;
mod bytes;
mod candidates;
mod comparison;
mod decision;
mod decoded;
mod descriptor;
mod duplicate;
mod filter;
mod grayscale;
#[cfg(test)]
mod guard;
mod hash;
mod histogram;
mod index;
mod kept;
mod luma;
mod octave;
mod relation;
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

use marf_stage::{StageDef, define};
use survey::{Section, Surveyed};

pub use by_hand::ByHand;
pub use comparison::{AnyPass, Contexts, Pass};
pub use decision::Decision;
pub use decoded::DecodedPhoto;
pub use filter::{Facts, Filter, MeasuredPhoto, Stored};
pub use luma::Luma;
pub use stage::FilterStage;
pub use survey::{measure_photo, tables};

/// Verdict of a photo whose bytes cannot be decoded here.
pub const DECODE: &str = "decode";

macro_rules! filters {
    ($($stage:ty),* $(,)?) => {
        /// The filters in the order in which `marf filter` runs them.
        pub const STAGES: &[StageDef] = &[$(define::<$stage>()),*];
        /// What each of them adds to a survey.
        const SECTIONS: &[Option<Section>] = &[$(<$stage as Surveyed>::SECTION),*];
        /// Name, version and guard of each of them.
        #[cfg(test)]
        const GUARDS: &[guard::Guarded] = &[$(guard::Guarded::of::<$stage>()),*];
    };
}

filters! {
    FilterStage<size::Size>,
    FilterStage<shape::Shape>,
    duplicate::Duplicate,
    FilterStage<grayscale::Grayscale>,
    FilterStage<histogram::Histogram>,
    FilterStage<blur::Blur>,
}
