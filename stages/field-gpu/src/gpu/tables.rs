//! The tables on the GPU: the places of levels in one array, and the kernels that look them up and train
//! them.

mod adam;
#[cfg(test)]
mod chain_tests;
mod encode;
#[cfg(test)]
mod fixture;
mod grid;
mod scales;
mod scatter;

pub use adam::{AdamArrays, AdamTable, rates};
pub use encode::{Encode, EncodeArrays};
pub use grid::{Grid, Slots};
pub use scales::{Rise, ScaleArrays, Scales, rescaling, start_scales};
pub use scatter::{Scatter, ScatterArrays, Sums};
