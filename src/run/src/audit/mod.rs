//! Provenance of a file, and everything derived from a product.

mod changed;
mod file;
mod from;
pub mod identity;
mod in_crate;
mod lineage;

pub use changed::Changed;
pub use file::{AuditReport, AuditRequest, audit, is_whole};
pub use from::{ProductUses, uses};
pub use in_crate::{CrateTrace, trace};
pub use lineage::{Detail, Origin, PhotoCount, Products, Step, StepInput};
pub use marf_model::product::Product;
