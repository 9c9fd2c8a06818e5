//! Photos to verdicts: the six filters.
//!
//! All filters together measure a photo once, from one decode (kept by the engine); each decides by thresholds
//! (cheap, always run again).
//! A new filter is one file here and one line in the `filters!` table below: config section, help text, cache
//! key and record come from its [`Filter`] implementation. Invariant: no verdict depends on the order of the
//! photos, and no threshold reaches a measure.

mod blur;
mod by_hand;
mod decoded;
mod descriptor;
mod duplicate;
mod filter;
mod grayscale;
mod hash;
mod histogram;
mod luma;
mod octave;
mod relation;
mod shape;
mod similarity;
mod size;
mod stage;
mod statistics;
mod survey;

use marf_stage::{StageDef, define};
use survey::{Section, Surveyed, Versions};

pub use blur::{Blur, BlurParams, BlurRule};
pub use by_hand::ByHand;
pub use decoded::DecodedPhoto;
pub use duplicate::{Duplicate, DuplicateParams, DuplicateRule};
pub use filter::{Decision, Filter, MeasuredPhoto};
pub use grayscale::{Grayscale, GrayscaleParams, Keep};
pub use histogram::{Histogram, HistogramParams, HistogramRule};
pub use luma::Luma;
pub use shape::{Shape, ShapeParams};
pub use size::{Size, SizeParams};
pub use stage::FilterStage;

/// What a survey depends on beside the photo.
const VERSIONS: Versions = Versions(SECTIONS);

/// Verdict of a photo whose bytes cannot be decoded here.
pub const DECODE: &str = "decode";

macro_rules! filters {
    ($($stage:ty),* $(,)?) => {
        /// The filters in the order in which the default pipeline runs them.
        pub const STAGES: &[StageDef] = &[$(define::<$stage>()),*];
        /// What each of them measures.
        const SECTIONS: &[Option<Section>] = &[$(<$stage as Surveyed>::SECTION),*];
    };
}

filters! {
    FilterStage<Size>,
    FilterStage<Shape>,
    Duplicate,
    FilterStage<Grayscale>,
    FilterStage<Histogram>,
    FilterStage<Blur>,
}
