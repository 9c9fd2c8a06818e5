//! Image metrics: PSNR (two definitions) and SSIM.

mod affine;
mod comparable;
mod logarithm;
mod psnr;
mod ssim;
#[cfg(test)]
mod tests;

pub use affine::psnr_affine;
pub use comparable::{Hidden, MetricError};
pub(crate) use logarithm::ln;
pub use psnr::{psnr, psnr_paper};
pub use ssim::ssim;
