//! `marf export cameras`: a folder with photos and cameras as other programs read them.

use std::path::PathBuf;

use clap::Args;
use marf_cache::Digest;
use marf_engine::{Cancel, NodeRun};
use marf_scene::Scene;
use marf_schema::cameras::CamerasParams;
use marf_schema::output::{CAMERAS, POINTS, SCENE, SPARSE};
use marf_stage::Params;
use serde_json::json;

use super::super::again::{run_nodes, run_with};
use super::super::args::Global;
use super::super::error::CliError;
use super::super::export::one;
use super::super::output::print_json;
use super::super::session::{digest, existing_store, node_named};
use crate::terminal::print_line;

/// The file that names photos and cameras.
pub const TRANSFORMS: &str = "transforms.json";

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

/// Writes transforms.json, its points, COLMAP's model and the photos that they name, each where transforms.json says it is.
pub fn export(global: &Global, args: &CamerasArgs, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
    let run = run_with(&store, args.run, &args.node)?;
    let scene = Scene::decode(&store.get(&digest(node_named(&run, &args.node)?, SCENE)?)?);
    let metres = scene
        .map_err(|error| CliError::failed(error.to_string()))?
        .metres_per_unit;
    let name = format!("cameras-of-{}", args.node);
    let table = json!({"uses": CamerasParams::STAGE, "input": args.node, "undistort": args.undistort});
    let (session, record) = run_nodes(store, &run, &[(&name, table)], global, cancel)?;
    let all = files_of(node_named(&record, &name)?);
    for (file, digest) in &all {
        session.check()?;
        one(&session, &record, digest, &args.out.join(file))?;
    }
    let photos = all.len() - model_count(&all);
    if global.json {
        let files: Vec<&str> = all.iter().map(|(file, _)| *file).collect();
        return print_json(
            &json!({"run": record.number, "folder": args.out, "files": files, "photos": photos, "metres_per_unit": metres}),
        );
    }
    let scale = metres.map_or("no scale".to_owned(), |metres| format!("one unit is {metres} m"));
    print_line(&format!(
        "wrote {}: {photos} photos with cameras, transforms.json (nerfstudio, instant-ngp), sparse/0 (COLMAP), points.ply; {scale}",
        args.out.display()
    ));
    Ok(())
}

/// Returns the files of the folder that a node `cameras` made, below that folder: models first, then photos.
pub fn files_of(node: &NodeRun) -> Vec<(&str, Digest)> {
    let files = node
        .outputs
        .iter()
        .filter_map(|(name, output)| Some((name.strip_prefix(CAMERAS)?, output.digest)));
    let mut files: Vec<(&str, Digest)> = files.collect();
    files.sort_by_key(|(name, _)| !is_model(name));
    files
}

/// Returns how many of the files are no photos.
pub fn model_count(files: &[(&str, Digest)]) -> usize {
    files.iter().filter(|(name, _)| is_model(name)).count()
}

fn is_model(name: &str) -> bool {
    name == TRANSFORMS || name == POINTS || name.starts_with(SPARSE)
}
