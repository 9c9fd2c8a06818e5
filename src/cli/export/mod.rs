//! `marf export`: a run, or what it made, for people and programs without the store.

mod surface;

use std::path::PathBuf;

use clap::{Args, Subcommand};
use marf_export::{Data, Photos};
use marf_run::export::cameras::{self, CamerasRequest};
use marf_run::export::{AttestRequest, CrateRequest, SurfaceKind};
use marf_run::{Context, Error};
use serde_json::json;

use super::global::Global;
use super::output::print_json;
use crate::terminal::{eprint_line, print_line};
use surface::{SplatsArgs, SurfaceArgs};

/// Verbs of `export`.
#[derive(Debug, Clone, Subcommand)]
pub enum ExportVerb {
    /// Write a run as a folder that strangers can check: an RO-Crate in a BagIt bag
    Crate(CrateArgs),
    /// Sign who made a result, by what and from what: an in-toto statement with SLSA provenance, in a DSSE envelope
    Attest(AttestArgs),
    /// Write cameras and photos as a folder: transforms.json (nerfstudio, instant-ngp), COLMAP's model (binary and text), points
    Cameras(CamerasArgs),
    /// Write the surface of a trained field as triangles: FILE.ply or FILE.glb (metres, y up)
    Mesh(SurfaceArgs),
    /// Write the surface of a trained field as points: FILE.ply
    Points(SurfaceArgs),
    /// Write the surface of a trained field as Gaussian splats, as viewers read them: FILE.ply; their PSNR against the field is told
    Splats(SplatsArgs),
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
    pub subject: Option<String>,
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

/// Arguments of `export cameras`.
#[derive(Debug, Clone, Args)]
pub struct CamerasArgs {
    /// A node with calibrated cameras
    #[arg(value_name = "NODE", default_value = "calibrate")]
    pub node: String,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write photos without the distortion of their lens, as PNG
    #[arg(long)]
    pub undistort: bool,
    /// Number of the run [default: the last one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
}

/// `marf export`.
pub fn export(global: &Global, verb: ExportVerb, context: &Context) -> Result<(), Error> {
    match verb {
        ExportVerb::Crate(args) => export_crate(global, args, context),
        ExportVerb::Attest(args) => attest(args, context),
        ExportVerb::Cameras(args) => export_cameras(global, args, context),
        ExportVerb::Mesh(args) => surface::export(global, args.request(SurfaceKind::Mesh), context),
        ExportVerb::Points(args) => surface::export(global, args.request(SurfaceKind::Points), context),
        ExportVerb::Splats(args) => surface::export(global, args.request(), context),
        ExportVerb::Height(args) => surface::export(global, args.request(SurfaceKind::Height), context),
        ExportVerb::Orthophoto(args) => {
            surface::export(global, args.request(SurfaceKind::Orthophoto), context)
        }
        ExportVerb::Depth(args) => surface::export(global, args.request(SurfaceKind::Depth), context),
    }
}

fn export_crate(global: &Global, args: CrateArgs, context: &Context) -> Result<(), Error> {
    let request = CrateRequest {
        dir: args.dir,
        run: args.run,
        photos: if args.items.is_empty() {
            Photos::All
        } else {
            Photos::Chosen(args.items)
        },
        data: if args.without_data {
            Data::Named
        } else {
            Data::Included
        },
        license: args.license,
        key: args.key,
    };
    let written = marf_run::export::export_crate(context, &request)?;
    if global.json {
        return print_json(&json!(written));
    }
    print_line(&format!(
        "wrote {}: run {} of {}, {} files, {} bytes, {} files named only",
        written.dir.display(),
        written.run,
        written.pipeline,
        written.files,
        written.bytes,
        written.named
    ));
    print_line(&format!("manifest SHA-256 {}", written.manifest_sha256));
    Ok(())
}

fn attest(args: AttestArgs, context: &Context) -> Result<(), Error> {
    let request = AttestRequest {
        subject: args.subject,
        key: args.key,
        run: args.run,
    };
    let attestation = marf_run::export::attest(context, &request)?;
    match &args.out {
        Some(out) => marf_run::files::write(out, &attestation.envelope)?,
        None => print_line(String::from_utf8_lossy(&attestation.envelope).trim_end()),
    }
    eprint_line(&format!("signed by key {}", attestation.key_id));
    Ok(())
}

fn export_cameras(global: &Global, args: CamerasArgs, context: &Context) -> Result<(), Error> {
    let request = CamerasRequest {
        node: args.node,
        out: args.out,
        undistort: args.undistort,
        run: args.run,
    };
    let result = cameras::export(context, &request)?;
    if global.json {
        return print_json(&json!(result));
    }
    let metres = result.metres_per_unit;
    let scale = metres.map_or("no scale".to_owned(), |metres| format!("one unit is {metres} m"));
    print_line(&format!(
        "wrote {}: {} photos with cameras, transforms.json (nerfstudio, instant-ngp), sparse/0 (COLMAP), points.ply; {scale}",
        result.folder.display(),
        result.photos
    ));
    Ok(())
}
