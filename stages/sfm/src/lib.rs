//! Structure from motion: photos to camera poses, lenses and sparse points.
//!
//! Steps, each a pure function of its arguments: [`features`] of a photo, [`matching`] of two photos, verification
//! and relative pose of a pair ([`two_view`]), the [`view_graph`] of all pairs, incremental mapping ([`mapper`]) with
//! bundle adjustment ([`bundle`]), and alignment with known poses ([`align`], [`metric`]).
//! Invariant: the same bits for any number of threads, any instruction set and any machine.

pub mod align;
pub mod bundle;
mod bytes;
mod estimators;
pub mod features;
pub mod mapper;
pub mod matching;
pub mod metric;
mod simd;
mod supervisor;
pub mod two_view;
pub mod view_graph;

pub use supervisor::Supervisor;

#[cfg(test)]
mod tests;

#[cfg(test)]
extern crate self as marf_sfm;
