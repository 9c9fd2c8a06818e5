//! The kernels on the CPU. Each has one body, compiled for three instruction sets with the same bits.

pub mod adam;
pub mod composite;
pub mod encode;
pub mod gemm;
pub mod march;
pub mod math;
pub mod net;
pub mod simd;
