//! A run as a folder that anyone can verify.

use std::path::PathBuf;

use marf_export::{CrateOptions, Data, Photos, write_crate};
use marf_model::Run;
use serde::Serialize;

use crate::choice::whole_run;
use crate::context::Context;
use crate::error::Error;
use crate::outputs::file_name;
use crate::trust::signing_key;

/// A run to export.
#[derive(Debug, Clone)]
pub struct CrateRequest {
    /// Folder to write, which must not exist.
    pub dir: PathBuf,
    /// Number of the run. None for the last one.
    pub run: Option<u64>,
    /// Whose bytes are included.
    pub photos: Photos,
    /// Whether photos and results are included or named only.
    pub data: Data,
    /// Licence of the crate.
    pub license: Option<String>,
    /// File of the private key that signs the crate, PEM.
    pub key: Option<PathBuf>,
}

/// An exported run.
#[derive(Debug, Serialize)]
pub struct CrateResult {
    /// The folder.
    #[serde(rename = "crate")]
    pub dir: PathBuf,
    /// Id of the run.
    pub run: String,
    /// Name of its pipeline.
    #[serde(skip)]
    pub pipeline: String,
    /// How many files there are.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// How many files are named only.
    pub named: u64,
    /// SHA-256 of the manifest.
    pub manifest_sha256: String,
}

/// Writes a crate.
///
/// # Errors
/// A run that is not there, a folder that is there or cannot be written.
pub fn export(context: &Context, request: &CrateRequest) -> Result<CrateResult, Error> {
    let key = request.key.as_deref().map(signing_key).transpose()?;
    let store = context.existing_store()?;
    let run = Run::new(&store, whole_run(context, &store, request.run)?)?;
    let options = CrateOptions {
        data: request.data,
        photos: request.photos.clone(),
        file_name,
        license: request.license.as_deref(),
        key: key.as_ref(),
    };
    let written = write_crate(&run, &options, &request.dir)?;
    Ok(CrateResult {
        dir: request.dir.clone(),
        run: run.record.id.clone(),
        pipeline: run.record.pipeline.clone(),
        files: written.files,
        bytes: written.bytes,
        named: written.named,
        manifest_sha256: written.manifest.to_string(),
    })
}
