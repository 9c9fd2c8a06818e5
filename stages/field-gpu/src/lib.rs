//! The radiance field on a GPU, through wgpu, and the choice of the device that trains and renders.
//!
//! Without the feature `gpu` the CPU is the only device, and no wgpu is compiled.

#[cfg(feature = "gpu")]
mod gpu;
mod open;

#[cfg(feature = "gpu")]
pub use gpu::Gpu;
pub use open::{backend_id, device_with_id, open, opened_id};
