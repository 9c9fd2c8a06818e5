//! Photos and priors to a calibrated scene: which photo was taken by which camera from where.
//!
//! `labels` takes the camera models of the archive's labels and resamples each photo once to an ideal pinhole;
//! `import` reads the cameras another program found; `colmap` runs an installed COLMAP. Invariant: a photo is in
//! the scene with a camera for the very bytes its frame names, or it is listed as unplaced with the reason; none
//! is dropped in silence.

#![allow(dead_code)]

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
mod metrics;
mod params;
mod photos;
mod resample;
mod stage;
mod two_view;

pub use export::{Sight, TrackPoint, Tracks, write_colmap, write_ply, write_transforms};
pub use metrics::{Metrics, Missing, PhotoMetrics, Totals};
pub use params::{CalibrateParams, Method};
pub use stage::{Calibrate, METRICS, POINTS, SCENE, SPARSE, TRANSFORMS};
