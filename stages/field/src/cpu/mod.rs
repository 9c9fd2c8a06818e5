//! The kernels on the CPU. Each has one body, compiled for three instruction sets with the same bits.
//!
//! Loops run over lane numbers: several arrays of one fixed length go in step, which the compiler vectorises.
#![allow(clippy::needless_range_loop)]

pub mod adam;
pub mod clearance;
pub mod composite;
pub mod encode;
pub mod gemm;
pub mod march;
pub mod math;
pub mod net;
pub mod simd;
pub mod space;

#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod gradients;
#[cfg(test)]
mod lookup_tests;
#[cfg(test)]
mod twins;
