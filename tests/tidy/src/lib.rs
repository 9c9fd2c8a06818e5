//! Measures the shape of the code in a checkout. The bars are in `tests/shape.rs`, the table is printed by
//! `cargo run -p marf-tidy`.
//!
//! Code is every Rust file, except folders named `tests`, `benches` or `fuzz`, items under `#[cfg(test)]`, and files that
//! are only reached through such an item. Build scripts, macros, examples and laboratory packages are code.
//!
//! Signatures, functions and names are read from the syntax tree, which does not see what a macro generates. Lines,
//! paths, matches and printing are read from tokens, also inside macros.

mod checkout;
mod claim;
mod graph;
mod measure;
mod modules;
mod packages;
mod paths;
mod rule;
mod scan;
mod signatures;
mod source;
mod table;

pub use checkout::{Checkout, Error};
pub use claim::is_claim;
pub use measure::{Circle, Measure, Report};
pub use rule::{Finding, Rule};
pub use table::table;
