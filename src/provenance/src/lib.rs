//! Who made this, from which bytes: runs, their nodes and products as the store has them.
//!
//! ```text
//! lineage.rs   a run: nodes with actions and records, inputs with the outputs that they are
//! product.rs   what a source read: products, and where their files came from
//! ```
//! This crate reads; it runs nothing and writes nothing. Invariant: what it says of a run is in the run's root or in objects
//! that the root leads to.

pub mod lineage;
pub mod product;

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

impl From<ManifestError> for LineageError {
    fn from(error: ManifestError) -> Self {
        Self::Malformed {
            what: "a set".to_owned(),
            message: error.to_string(),
        }
    }
}
