//! Photos to verdicts: the six filters.
//!
//! Each filter measures a photo once (kept by the engine) and decides by thresholds (cheap, always run again).
//! A new filter is one file here and one line in the `filters!` table below: config section, help text, cache
//! key and record come from its [`Filter`] implementation. Invariant: no verdict depends on the order of the
//! photos, and no threshold reaches a measure.

mod adapter;
mod blur;
mod duplicate;
mod filter;
mod grayscale;
mod histogram;
mod luma;
mod near;
mod shape;
mod size;
mod sketch;
mod statistics;

use marf_stage::{StageDef, define};

pub use adapter::Judge;
pub use blur::{Blur, BlurParams, BlurRule};
pub use duplicate::{Duplicate, DuplicateParams, DuplicateRule};
pub use filter::{Filter, Opinion, Seen, Sight, Unreadable};
pub use grayscale::{Grayscale, GrayscaleParams, Keep};
pub use histogram::{Histogram, HistogramParams, HistogramRule};
pub use shape::{Shape, ShapeParams};
pub use size::{Size, SizeParams};

/// Verdict of a photo whose bytes cannot be decoded here.
pub const DECODE: &str = "decode";

macro_rules! filters {
    ($($stage:ty),* $(,)?) => {
        /// The filters in the order in which the default pipeline runs them.
        pub const STAGES: &[StageDef] = &[$(define::<$stage>()),*];
    };
}

filters! {
    Judge<Size>,
    Judge<Shape>,
    Duplicate,
    Judge<Grayscale>,
    Judge<Histogram>,
    Judge<Blur>,
}
