//! A run and its nodes as stored, and the selection of a run.
//!
//! ```text
//! run.rs       a run: nodes with actions and records, inputs as outputs of other nodes, documents
//! product.rs   products that a source read, and where their files came from
//! select.rs    the run that a verb takes: the newest one, the newest with a result, the newest whole one
//! ```
//! Invariant: everything here is read from the root of a run or from objects that the root leads to. Nothing is written.

mod error;
pub mod product;
mod run;
pub mod select;

pub use error::{RunError, unless_lost};
pub use run::{Run, RunNode};
