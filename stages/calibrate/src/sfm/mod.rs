//! Method `sfm`: structure from motion of the photos of the input set, with labels as priors.
//!
//! Features and matches are kept in memos keyed by their inputs, so that only new photos are computed. The mapping is repeated with all
//! photos, and so depends on the set alone.

mod assemble;
mod cameras;
mod capture_order;
mod compare;
mod earlier;
mod error;
mod fixed_masks;
mod links;
mod overlap;
mod pair_memos;
mod photo_features;
mod points;
mod reasons;
mod reconstruction;
mod run;

pub(crate) use assemble::sparse;
pub(crate) use capture_order::capture_order;
pub(crate) use compare::{seed_of, view_overlap};
pub(crate) use earlier::earlier_scene;
pub(crate) use overlap::{Overlap, overlaps};
pub(crate) use photo_features::{PhotoFeatures, features_of};
pub(crate) use points::points_of_known;
pub(crate) use run::run;
