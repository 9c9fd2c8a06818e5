//! The field on a GPU, through wgpu: kernels in WGSL, each the twin of one in `cpu`.
//!
//! Invariant: no kernel adds floats in an order that threads decide. Sums over many threads are integers or
//! go through partial sums in the order of their index. Two runs on one adapter give the same bytes.

mod array;
mod arrays;
mod backend;
mod batch;
#[cfg(test)]
mod chain_device;
#[cfg(test)]
mod chain_f64;
#[cfg(test)]
mod chain_tests;
#[cfg(test)]
mod constants_tests;
#[cfg(test)]
mod core_tests;
mod device;
mod exposures;
#[cfg(test)]
mod exposures_tests;
#[cfg(test)]
mod extreme_tests;
mod forward;
mod kernel;
mod learning;
mod light;
#[cfg(test)]
mod light_tests;
#[cfg(test)]
mod losses_tests;
mod march;
#[cfg(test)]
mod march_tests;
mod memory;
#[cfg(test)]
mod memory_tests;
mod nets;
#[cfg(test)]
mod nets_adam_tests;
#[cfg(test)]
mod nets_tests;
mod occupancy;
mod order;
mod picture;
#[cfg(test)]
mod picture_tests;
mod rays;
#[cfg(test)]
mod rays_tests;
mod record;
mod renderer;
#[cfg(test)]
mod rig;
#[cfg(test)]
mod rounding_tests;
#[cfg(test)]
mod scan_tests;
mod session;
#[cfg(test)]
mod session_tests;
mod submits;
mod tables;
#[cfg(test)]
pub(crate) mod testing;
mod totals;
mod weights;

pub use device::Gpu;
