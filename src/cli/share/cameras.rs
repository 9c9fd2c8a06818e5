//! `marf export cameras`: a folder with photos and cameras as other programs read them.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

use clap::Args;
use marf_cache::{Digest, Store};
use marf_engine::Cancel;
use marf_scene::Scene;
use marf_schema::output::{POINTS, SCENE, SPARSE, TRANSFORMS};
use serde_json::json;

use super::super::again::run_with;
use super::super::args::Global;
use super::super::copies::copy;
use super::super::error::CliError;
use super::super::files;
use super::super::output::print_json;
use super::super::session::{digest, existing_store};
use crate::terminal::print_line;

/// Arguments of `export cameras`.
#[derive(Debug, Clone, Args)]
pub struct CamerasArgs {
    /// A node with calibrated cameras
    #[arg(value_name = "NODE", default_value = "calibrate")]
    pub node: String,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of the run [default: the last one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
}

/// Writes transforms.json, its points, COLMAP's model and the photos that they name, each where transforms.json says it is.
pub fn export(global: &Global, args: &CamerasArgs, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
    let run = run_with(&store, args.run, &args.node)?;
    let node = super::super::session::node_named(&run, &args.node)?;
    let scene = Scene::decode(&store.get(&digest(node, SCENE)?)?);
    let scene = scene.map_err(|error| CliError::failed(error.to_string()))?;
    let photos = photo_files(&scene)?;
    let models = node
        .outputs
        .iter()
        .filter(|(name, _)| name.starts_with(SPARSE) || *name == POINTS);
    let mut all = vec![(PathBuf::from("transforms.json"), digest(node, TRANSFORMS)?)];
    all.extend(models.map(|(name, output)| (PathBuf::from(name), output.digest)));
    let model_files = all.len();
    all.extend(photos);
    for (file, digest) in &all {
        write(&store, digest, run.root, &args.out.join(file))?;
    }
    let photos = all.len() - model_files;
    let metres = scene.metres_per_unit;
    if global.json {
        let files: Vec<&PathBuf> = all.iter().map(|(file, _)| file).collect();
        return print_json(
            &json!({"run": run.number, "folder": args.out, "files": files, "photos": photos, "metres_per_unit": metres}),
        );
    }
    let scale = metres.map_or("no scale".to_owned(), |metres| format!("one unit is {metres} m"));
    print_line(&format!(
        "wrote {}: {photos} photos with cameras, transforms.json (nerfstudio, instant-ngp), sparse/0 (COLMAP), points.ply; {scale}",
        args.out.display()
    ));
    Ok(())
}

/// Returns the file and the digest of each photo.
///
/// # Errors
/// A name that leads out of the folder, or that two photos share.
fn photo_files(scene: &Scene) -> Result<Vec<(PathBuf, Digest)>, CliError> {
    let mut known = BTreeSet::new();
    let file = |frame: &marf_scene::Frame| {
        let path = Path::new(&frame.file);
        let is_plain = path.components().all(|part| matches!(part, Component::Normal(_)));
        if !is_plain || !known.insert(frame.file.clone()) {
            return Err(CliError::failed(format!(
                "the photo `{}` cannot be written as `{}`: the name leads out of the folder, or another photo has it",
                frame.id, frame.file
            )));
        }
        Ok((path.to_owned(), frame.image))
    };
    scene.frames.iter().map(file).collect()
}

fn write(store: &Store, digest: &Digest, run: Option<Digest>, path: &Path) -> Result<(), CliError> {
    let bytes = store.get(digest)?;
    files::write(path, &copy(path, digest, &bytes, run))
}
