//! Photos and priors to a calibrated scene: which photo was taken by which camera from where.
//!
//! `sfm` finds cameras from the photos themselves, with labels as priors; `labels` takes the camera models of
//! the archive's labels and resamples each photo once to an ideal pinhole; `import` reads the cameras another
//! program found; `colmap` runs an installed COLMAP. Invariant: a photo is in the scene with a camera for the
//! very bytes its frame names, or it is listed as unplaced with the reason; none is dropped in silence.

mod align;
mod bundle;
mod colmap;
mod dice;
mod estimators;
mod export;
mod features;
pub mod import;
mod labels;
mod mapper;
mod masks;
mod matching;
mod metric;
mod photos;
mod resample;
mod sfm;
mod simd;
mod stage;
mod two_view;

pub use export::{Sight, TrackPoint, Tracks, write_colmap, write_ply, write_transforms};
use marf_schema::calibrate as params;
pub use marf_schema::calibrate::{
    CalibrateParams, FirstOctaveParam, Intrinsics, LensParam, Method, Metrics, Missing, Pairs, PhotoMetrics,
    PrincipalPoint, Totals,
};
pub use stage::{Calibrate, METRICS, POINTS, SCENE, SPARSE, TRANSFORMS};

/// What the benches measure; no part of the interface.
#[doc(hidden)]
pub mod bench_api {
    pub use crate::bundle::bench::{Adjustment, adjustment};

    use marf_scene::{Image, Srgb};

    use crate::features::{FeatureOptions, Features, Gray, Mask, extract};
    use crate::matching::{MatchOptions, match_pair};

    /// Features of a photo.
    pub struct Found(Features);

    /// A photo at its working size.
    pub struct Working(Gray, Mask);

    impl Working {
        /// Shrinks a photo.
        pub fn new(photo: &Image<Srgb>, factor: u32) -> Self {
            Self(Gray::of(photo, factor), Mask::of(photo, factor, None))
        }

        /// Finds features with the default options.
        pub fn extract(&self) -> Found {
            Found(extract(&self.0, &self.1, &FeatureOptions::default()))
        }
    }

    impl Found {
        /// Returns how many.
        pub fn count(&self) -> usize {
            self.0.keypoints.len()
        }

        /// Returns them as bytes.
        pub fn encode(&self) -> Vec<u8> {
            self.0.encode()
        }

        /// Matches two photos with the default options.
        pub fn matches(&self, other: &Self) -> Vec<[u32; 2]> {
            match_pair(&self.0, &other.0, &MatchOptions::default())
        }
    }
}
