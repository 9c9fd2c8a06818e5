//! Who made this, from which bytes: runs, their nodes and products as the store has them.
//!
//! ```text
//! lineage.rs   a run: nodes with actions and records, inputs with the outputs that they are
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
pub mod lineage;
pub mod nearest;
pub mod product;
pub mod replay;
pub mod stamp;
pub mod taint;
pub mod verify;

use marf_cache::{Digest, StoreError, manifest::ManifestError};
use marf_engine::EngineError;

/// Why a lineage cannot be told.
#[derive(Debug, thiserror::Error)]
pub enum LineageError {
    /// The store cannot be read, or has lost an object.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A run cannot be read.
    #[error(transparent)]
    Run(#[from] EngineError),
    /// An object is not what it should be.
    #[error("{what} cannot be read: {message}")]
    Malformed {
        /// The object.
        what: String,
        /// The error of the reader.
        message: String,
    },
    /// A record is not in the store.
    #[error("the record of {of} (key {}) is not in the store", key.short())]
    NoRecord {
        /// Of what.
        of: String,
        /// Its key.
        key: Digest,
    },
}

impl LineageError {
    /// Tells whether something was collected or lost that the lineage needs.
    pub fn is_lost(&self) -> bool {
        match self {
            Self::Store(error) => error.lost().is_some(),
            Self::NoRecord { .. } => true,
            Self::Run(_) | Self::Malformed { .. } => false,
        }
    }
}

/// Returns what was read; none if the store has lost an object that it needs.
///
/// # Errors
/// Every other error.
pub fn unless_lost<T>(read: Result<T, LineageError>) -> Result<Option<T>, LineageError> {
    match read {
        Err(error) if error.is_lost() => Ok(None),
        read => read.map(Some),
    }
}

impl From<ManifestError> for LineageError {
    fn from(error: ManifestError) -> Self {
        Self::Malformed {
            what: "a set".to_owned(),
            message: error.to_string(),
        }
    }
}
