//! `marf export`: a run or its results for use without the store.

mod surface;

use std::path::PathBuf;

use clap::{Args, Subcommand};
use marf_export::{Data, Photos};
use marf_progress::format::{count, number, size};
use marf_run::export::cameras::{self, CamerasRequest};
use marf_run::export::{CrateRequest, SurfaceKind};
use marf_run::{Context, Error};

use super::options::{RecordArgs, StoreArgs, ThreadsArg};
use super::output::print_json;
use crate::terminal::{eprint_line, print_document, print_line};
use surface::{SplatsArgs, SurfaceArgs};

/// Verbs of `export`.
#[derive(Debug, Clone, Subcommand)]
pub enum ExportVerb {
    /// Export a run as a folder that others can verify: an RO-Crate in a BagIt bag
    Crate(CrateArgs),
    /// Sign the provenance of a result: an in-toto statement with SLSA provenance in a DSSE envelope
    Attest(AttestArgs),
    /// Export cameras, photos and points for nerfstudio, instant-ngp and COLMAP
    Cameras(CamerasArgs),
    /// Export the surface of a field as a mesh: FILE.ply or FILE.glb (metres, y up)
    Mesh(SurfaceArgs),
    /// Export the surface of a field as points: FILE.ply
    Points(SurfaceArgs),
    /// Export the surface of a field as Gaussian splats, and report their PSNR: FILE.ply
    Splats(SplatsArgs),
    /// Export a height map and its uncertainty: FILE.png (16 bits, world file) or FILE.tif (GeoTIFF)
    Height(SurfaceArgs),
    /// Export an orthophoto: FILE.png with a world file, or FILE.tif (GeoTIFF)
    Orthophoto(SurfaceArgs),
    /// Export the depth of a field at every photo: a folder of 16-bit PNG
    Depth(SurfaceArgs),
}

/// Arguments of `export crate`.
#[derive(Debug, Clone, Args)]
pub struct CrateArgs {
    /// Folder to write, which must not exist
    pub dir: PathBuf,
    /// Number of the run [default: the newest whole one]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Include only the bytes of these photos (product ids), and every decision on them
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    pub items: Vec<String>,
    /// Leave out the bytes of photos and results, and name them by digest
    #[arg(long)]
    pub without_data: bool,
    /// Licence of the crate: an SPDX id (`CC-BY-4.0`) or a URL
    #[arg(long, value_name = "LICENCE")]
    pub license: Option<String>,
    /// Sign the crate with this Ed25519 key (PEM, PKCS#8)
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
    #[command(flatten)]
    record: RecordArgs,
}

/// Arguments of `export attest`.
#[derive(Debug, Clone, Args)]
pub struct AttestArgs {
    /// Node, or file with the bytes of a result [default: all results of the run]
    #[arg(value_name = "NODE|FILE")]
    pub subject: Option<String>,
    /// Sign with this Ed25519 key (PEM, PKCS#8)
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// Number of the run [default: the newest whole one]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// File to write [default: stdout]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    store: StoreArgs,
}

/// Arguments of `export cameras`.
#[derive(Debug, Clone, Args)]
pub struct CamerasArgs {
    /// Node with calibrated cameras
    #[arg(value_name = "NODE", default_value = "calibrate")]
    pub node: String,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write undistorted photos as PNG
    #[arg(long)]
    pub undistort: bool,
    /// Number of the run [default: the newest one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    #[command(flatten)]
    record: RecordArgs,
    #[command(flatten)]
    threads: ThreadsArg,
}

/// `marf export`.
pub fn export(verb: ExportVerb, context: Context) -> Result<(), Error> {
    match verb {
        ExportVerb::Crate(args) => export_crate(args, context),
        ExportVerb::Attest(args) => attest(args, context),
        ExportVerb::Cameras(args) => export_cameras(args, context),
        ExportVerb::Mesh(args) => args.export(SurfaceKind::Mesh, None, context),
        ExportVerb::Points(args) => args.export(SurfaceKind::Points, None, context),
        ExportVerb::Splats(args) => {
            let SplatsArgs { surface, pictures } = args;
            surface.export(SurfaceKind::Splats, pictures, context)
        }
        ExportVerb::Height(args) => args.export(SurfaceKind::Height, None, context),
        ExportVerb::Orthophoto(args) => args.export(SurfaceKind::Orthophoto, None, context),
        ExportVerb::Depth(args) => args.export(SurfaceKind::Depth, None, context),
    }
}

fn export_crate(args: CrateArgs, context: Context) -> Result<(), Error> {
    let context = args.record.store.context(context);
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
    let written = marf_run::export::export_crate(&context, &request)?;
    if args.record.json {
        return print_json(&written);
    }
    print_line(&format!(
        "wrote {}: run {} of {}, {} ({}) in data/, {} more named by digest only",
        written.dir.display(),
        written.run,
        written.pipeline,
        count(written.files as usize, "file"),
        size(written.bytes),
        written.named
    ));
    print_line(&format!("manifest SHA-256 {}", written.manifest_sha256));
    Ok(())
}

fn attest(args: AttestArgs, context: Context) -> Result<(), Error> {
    let context = args.store.context(context);
    let attestation = marf_run::export::attest(&context, args.subject.as_deref(), &args.key, args.run)?;
    match &args.out {
        Some(out) => marf_run::files::write(out, &attestation.envelope)?,
        None => print_document(String::from_utf8_lossy(&attestation.envelope).trim_end()),
    }
    eprint_line(&format!("signed by key {}", attestation.key_id));
    Ok(())
}

fn export_cameras(args: CamerasArgs, context: Context) -> Result<(), Error> {
    let context = args.threads.context(args.record.store.context(context));
    let request = CamerasRequest {
        node: args.node,
        out: args.out,
        undistort: args.undistort,
        run: args.run,
    };
    let result = cameras::export(&context, &request)?;
    if args.record.json {
        return print_json(&result);
    }
    let metres = result.metres_per_unit;
    let scale = metres.map_or("no scale".to_owned(), |metres| {
        format!("one unit is {} m", number(metres))
    });
    print_line(&format!(
        "wrote {}: {} with cameras, transforms.json (nerfstudio, instant-ngp), sparse/0 (COLMAP), points.ply ({scale})",
        result.folder.display(),
        count(result.photos, "photo")
    ));
    Ok(())
}
