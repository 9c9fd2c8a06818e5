//! Random numbers, quantiles, the curve of sRGB, connected parts and the choice of instruction set, for every crate that computes.
//!
//! Invariant: the same seed gives the same numbers, and every instruction set the same bits, on every machine.

mod connected;
mod grouped;
mod instruction_set;
mod quantiles;
mod rng;
mod srgb;

pub use connected::{lowest_joined, visit_parts};
pub use grouped::grouped;
#[cfg(target_arch = "x86_64")]
pub use instruction_set::{Avx2, Avx512};
pub use instruction_set::{Dispatch, InstructionSet, Plain};
pub use quantiles::{lower_median, quantile, upper_median};
pub use rng::{GOLDEN, Rng, mix};
pub use srgb::linear_light;
