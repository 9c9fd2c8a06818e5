//! Runs as files that strangers can check.
//!
//! ```text
//! run.rs        what a run must have to be exported
//! contents/     objects of the store that are included
//! graph/        what ran on what, as JSON-LD (RO-Crate 1.1, Provenance Run Crate 0.5)
//! bag/          BagIt bags: every file with its SHA-256
//! crates.rs     all of that in one folder
//! statement.rs  in-toto statements with SLSA provenance (dsse.rs signs them, key.rs reads keys)
//! verify/       the check of a crate that needs no store
//! ```
//!
//! Invariant: the same run gives the same bytes. Nothing here reads a clock or an environment.

pub mod bag;
mod contents;
mod crates;
pub mod dsse;
mod error;
mod graph;
mod run;
mod statement;
mod time;
pub mod verify;

pub use contents::Photos;
pub use crates::{CrateOptions, Data, Written, write_crate};
pub use error::ExportError;
pub use statement::{Subject, statement_on_node, statement_on_run, subjects_in, subjects_of};
pub use time::iso_time;
