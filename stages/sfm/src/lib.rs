//! Structure from motion: verified pairs of photos to camera poses, lenses and sparse points.
//!
//! Steps, each a pure function of its arguments: the [`view_graph`] of all pairs, incremental mapping ([`mapper`]) with
//! bundle adjustment ([`bundle`]), alignment with known poses ([`align`], [`metric`], [`rigs`]), exposures ([`tones`]) and
//! [`vignetting`]. Pairs are compared in `marf-sfm-features`.
//! Invariant: the same bits for any number of threads, any instruction set and any machine.

pub mod align;
pub mod bundle;
pub mod mapper;
pub mod metric;
pub mod rigs;
pub mod tones;
pub mod view_graph;
pub mod vignetting;

#[cfg(test)]
mod tests;

#[cfg(test)]
extern crate self as marf_sfm;
