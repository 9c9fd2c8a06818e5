//! B retrainings to uncertainty maps and a fly-through.
//!
//! One stage, `bootstrap`: it asks for B `train` nodes and reduces their fields to maps of mean and spread, to
//! figures of how far the spread can be trusted, and to a fly-through. Invariant: the members are put in order
//! pixel by pixel before they are added up, so no map depends on the order of the members.

mod calibration;
mod draw;
mod error;
mod maps;
mod npy;
mod params;
mod reduce;
mod report;
mod sparsification;

pub use calibration::{Intervals, calibrate, conformal_rank, coverage, nll, scale_t};
pub use error::BootstrapError;
pub use maps::{Maps, maps, sample_std};
pub use npy::encode_npy;
pub use params::Bootstrap;
pub use sparsification::{Norm, Sparsification, pearson, sparsify, spearman};
