//! Photos to pairs of photos that show the same scene: what incremental mapping starts from.
//!
//! Steps, each a pure function of its arguments: [`features`] of a photo, [`matching`] of two photos, verification and
//! relative pose of a pair ([`two_view`]). [`estimators`] holds the solvers.
//! Invariant: the same bits for any number of threads, any instruction set and any machine.

pub mod estimators;
pub mod features;
pub mod matching;
mod simd;
pub mod two_view;
