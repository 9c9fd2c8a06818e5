//! The check of a crate that needs no store, and no trust in who made it.
//!
//! ```text
//! bag      every file is listed and has the listed digest          (bag/read.rs)
//! graph    its form is known, every reference leads somewhere, files have the digests it gives (entities.rs)
//! actions  bytes of actions give their keys, and tools, inputs, parameters and results are those of the graph (actions.rs)
//! lineage  inputs were made by an action or read from an archive, and photos lead to files of the archive (lineage.rs)
//! signature (signature.rs)
//! ```

mod actions;
mod entities;
mod lineage;
mod open;
mod signature;
mod trace;

use std::path::Path;

use marf_cache::{Digest, Sha256};
use marf_engine::Cancel;
use serde::Serialize;

use marf_keys::PublicKey;

pub use open::{OpenCrate, OpenError};
pub use signature::Signature;
pub use trace::{Product, Role, Step, Trace};

/// Result of a check.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Name of the run.
    pub run: String,
    /// Digest of the run root.
    pub root: Digest,
    /// Digest of the manifest of the payload.
    pub manifest_sha256: Option<Sha256>,
    /// Files of the payload.
    pub files: u64,
    /// Files that are named by their digest and not included.
    pub named: u64,
    /// Actions whose bytes gave their keys.
    pub actions: u64,
    /// Photos that were followed to the files of the archive.
    pub photos: u64,
    /// State of the signature under the given key.
    pub signature: Signature,
    /// All faults, one sentence each. Empty for a sound crate.
    pub faults: Vec<String>,
}

/// Checks a crate: all of it, and the signature against a key if one is given.
///
/// # Errors
/// A folder that is not a crate of ours, or one of a newer form. The wish of the user to stop. All other
/// faults are in the report.
pub fn verify(folder: &Path, key: Option<&PublicKey>, cancel: &Cancel) -> Result<Report, OpenError> {
    let opened = OpenCrate::open(folder, cancel)?;
    let mut faults: Vec<String> = opened.bag.faults.iter().map(ToString::to_string).collect();
    faults.extend(entities::check(&opened));
    let actions = actions::check(&opened, &mut faults);
    let photos = lineage::check(&opened, &mut faults);
    let signature = signature::check(&opened, key, &mut faults);
    if cancel.is_set() {
        return Err(OpenError::Stopped);
    }
    Ok(Report {
        run: opened.run.id.clone(),
        root: Digest::from_content(&opened.root),
        manifest_sha256: opened
            .bag
            .tag(crate::bag::MANIFEST)
            .map(|bytes| Sha256::from_content(&bytes)),
        files: opened.bag.payload.len() as u64,
        named: opened.named() as u64,
        actions,
        photos,
        signature,
        faults,
    })
}
