//! Features: points that can be found again in other photos of the same scene (SIFT).
//!
//! A pure function of a photo's pixels, its mask and the options. Invariant: keypoints are sorted by octave, layer, row
//! and column, and are equal to the bit on every instruction set.

mod codec;
mod describe;
mod extract;
mod extrema;
mod gradient;
mod gray;
mod keypoint;
mod mask;
mod orient;
mod pyramid;
mod ranking;

pub use extract::{FeatureOptions, extract};
pub use gray::Gray;
pub use keypoint::{Descriptor, Features, Keypoint};
pub use mask::Mask;
pub use pyramid::FirstOctave;

#[cfg(test)]
mod tests;
