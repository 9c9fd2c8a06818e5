//! Runs and their results for use without the store.

mod attest;
pub mod cameras;
mod crates;
mod surface;
mod verify;

pub use attest::{Attestation, attest};
pub use crates::{CrateRequest, CrateResult, export as export_crate};
pub use surface::{SurfaceKind, SurfaceRequest, SurfaceResult, export as export_surface, splats};
pub use verify::{CrateCheck, Statement, VerifyResult, open_crate, verify_crate, verify_path};
