//! Input of a graph.

use marf_engine::RunRecord;
use marf_model::Run;

use crate::bag::FileDigest;
use crate::contents::{Contents, File};

/// Name of the graph's file in the payload.
pub const METADATA: &str = "ro-crate-metadata.json";
/// Version of the form of our crates. A newer one is refused.
pub const CRATE_FORMAT: u32 = 1;
/// Prefix of [`CRATE_FORMAT`] in the id of the profile of our crates.
pub const CRATE_PROFILE: &str = "urn:x-marf:crate:";

/// A file of the graph: in the crate, or named by its digest alone.
#[derive(Debug, Clone)]
pub struct Described<'a> {
    /// The file.
    pub file: &'a File,
    /// Its length and digests.
    pub digest: FileDigest,
    /// Its id: the path in the payload, or a URI with its SHA-256.
    pub id: String,
}

/// All that the graph is made of.
pub struct GraphInput<'a> {
    /// The run.
    pub run: &'a Run<'a>,
    /// Contents of the crate.
    pub contents: &'a Contents,
    /// Its described files.
    pub files: &'a [Described<'a>],
    /// Licence of the crate: an SPDX id or a URL. `None` if none was stated.
    pub license: Option<&'a str>,
}

/// Returns the name of the root of a run.
pub fn root_name(run: &RunRecord) -> String {
    let digits = run.root.map(|root| root.to_string()).unwrap_or_default();
    format!("blake3:{digits}")
}
