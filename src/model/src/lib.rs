//! A run and its nodes as the store has them, and which run is meant.
//!
//! ```text
//! run.rs       a run: nodes with actions and records, inputs with the outputs that they are, documents
//! product.rs   what a source read: products, and where their files came from
//! select.rs    which run a verb takes: the newest one, the newest with a result, the newest whole one
//! ```
//! Invariant: everything here is read from the root of a run or from objects that the root leads to. Nothing is written.

mod error;
pub mod product;
mod run;
pub mod select;

pub use error::{RunError, unless_lost};
pub use run::{Run, RunNode};
