//! Who made this, from which bytes: runs, their nodes and products as the store has them.
//!
//! ```text
//! run.rs   a run: nodes with actions and records, inputs with the outputs that they are
//! product.rs   what a source read: products, and where their files came from
//! find.rs      a content: as what, and by which nodes of which runs
//! nearest.rs   a file that nobody made: which object it resembles most
//! stamp.rs     marks in exported copies
//! taint.rs     a product: what it went into
//! replay.rs    what a run needs to be made again, and how what came compares with it
//! diff.rs      what changed between two runs
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
