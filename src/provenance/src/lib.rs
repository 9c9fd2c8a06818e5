//! Who made this, from which bytes: runs, their nodes and products as the store has them.
//!
//! ```text
//! run.rs   a run: nodes with actions and records, inputs with the outputs that they are
//! product.rs   what a source read: products, and where their files came from
//! find.rs      a content: its role, and the nodes and runs that have it
//! nearest.rs   a file that no node made: the object it resembles most
//! stamp.rs     marks in exported copies
//! taint.rs     a product: everything derived from it
//! replay.rs    needs of a replay, and the comparison of its results with the run
//! diff.rs      changes between two runs
//! difference.rs where and by how much two contents differ
//! verify.rs    every byte of a lineage against its digest
//! ```
//! This crate runs nothing, and writes nothing but copies of objects into the store of a replay. Invariant: what it says of a run is in the run's root or in objects
//! that the root leads to.

pub mod diff;
pub mod difference;
pub mod find;
pub mod nearest;
pub mod replay;
pub mod stamp;
pub mod taint;
pub mod verify;
