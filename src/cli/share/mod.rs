//! Verbs that hand a run, or what it made, to people and programs without the store, and check what was handed over.

mod attest;
pub mod cameras;
mod export_crate;
mod run;
mod surface;
mod verify;

use std::path::PathBuf;

use clap::{Args, Subcommand};
use marf_engine::Cancel;
use marf_export::ExportError;

use super::args::Global;
use super::error::{Answer, CliError, Diagnostic};
use surface::{Kind, SurfaceArgs};

pub use verify::{VerifyArgs, open_crate, verify_crate, verify_path};

/// Verbs of `export`.
#[derive(Debug, Clone, Subcommand)]
pub enum ExportVerb {
    /// Write a run as a folder that strangers can check: an RO-Crate in a BagIt bag
    Crate(CrateArgs),
    /// Sign who made a result, by what and from what: an in-toto statement with SLSA provenance, in a DSSE envelope
    Attest(AttestArgs),
    /// Write cameras and photos as a folder: transforms.json (nerfstudio, instant-ngp), COLMAP's model (binary and text), points
    Cameras(cameras::CamerasArgs),
    /// Write the surface of a trained field as triangles: FILE.ply or FILE.glb (metres, y up)
    Mesh(SurfaceArgs),
    /// Write the surface of a trained field as points: FILE.ply
    Points(SurfaceArgs),
    /// Write heights as FILE.png of 16 bits with a world file, or FILE.tif (GeoTIFF, metres), and beside it how far the views differ
    Height(SurfaceArgs),
    /// Write the surface as seen from straight above: FILE.png with a world file, or FILE.tif (GeoTIFF)
    Orthophoto(SurfaceArgs),
    /// Write the depths of a trained field at the views of its photos into a folder: PNG of 16 bits, the scale in their text
    Depth(SurfaceArgs),
}

/// Arguments of `export crate`.
#[derive(Debug, Clone, Args)]
pub struct CrateArgs {
    /// Folder to write; it must not be there yet
    pub dir: PathBuf,
    /// Number of the run [default: the last one]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Only the bytes of these photos (product ids), and every decision on each
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    pub items: Vec<String>,
    /// Name photos and results by their digests, and leave their bytes out
    #[arg(long)]
    pub without_data: bool,
    /// Licence of the crate: an SPDX id (`CC-BY-4.0`) or a URL
    #[arg(long, value_name = "LICENCE")]
    pub license: Option<String>,
    /// Sign the crate with this Ed25519 key (PEM, PKCS#8)
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
}

/// Arguments of `export attest`.
#[derive(Debug, Clone, Args)]
pub struct AttestArgs {
    /// A node, or a file with the bytes of a result [default: all results of the run]
    #[arg(value_name = "NODE|FILE")]
    pub of: Option<String>,
    /// Sign with this Ed25519 key (PEM, PKCS#8)
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// Number of the run [default: the last one]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Where to [default: stdout]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// `marf export`.
pub fn export(global: &Global, verb: &ExportVerb, cancel: &Cancel) -> Result<(), CliError> {
    match verb {
        ExportVerb::Crate(args) => export_crate::export(global, args, cancel),
        ExportVerb::Attest(args) => attest::attest(global, args, cancel),
        ExportVerb::Cameras(args) => cameras::export(global, args, cancel),
        ExportVerb::Mesh(args) => surface::export(global, Kind::Mesh, args, cancel),
        ExportVerb::Points(args) => surface::export(global, Kind::Points, args, cancel),
        ExportVerb::Height(args) => surface::export(global, Kind::Height, args, cancel),
        ExportVerb::Orthophoto(args) => surface::export(global, Kind::Orthophoto, args, cancel),
        ExportVerb::Depth(args) => surface::export(global, Kind::Depth, args, cancel),
    }
}

/// Returns the error of something that is not as it was made.
fn altered(diagnostic: Diagnostic) -> CliError {
    CliError::Answered(Answer::Altered, diagnostic)
}

impl From<ExportError> for CliError {
    fn from(error: ExportError) -> Self {
        let diagnostic = Diagnostic {
            message: error.to_string(),
            cause: None,
            hint: error.hint().map(str::to_owned),
        };
        match error {
            ExportError::UnknownItem { .. }
            | ExportError::UnknownNode { .. }
            | ExportError::Exists { .. } => Self::Usage(diagnostic),
            _ => Self::Failed(diagnostic),
        }
    }
}
