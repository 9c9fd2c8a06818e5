//! A folder with photos and cameras as other programs read them.

use std::path::PathBuf;

use marf_cache::Digest;
use marf_engine::{NodeRun, Purpose};
use marf_schema::cameras::CamerasParams;
use marf_schema::output::{CAMERAS, MASKS, POINTS, SPARSE};
use marf_stage::Params;
use serde::Serialize;
use serde_json::json;

use crate::choice::RunChoice;
use crate::context::Context;
use crate::derived::{AddedNode, DerivedRun, run_nodes};
use crate::error::Error;
use crate::outputs;
use crate::session::{node_named, read_scene};

/// The file that names photos and cameras.
pub const TRANSFORMS: &str = "transforms.json";

/// Cameras to export.
#[derive(Debug, Clone)]
pub struct CamerasRequest {
    /// A node with calibrated cameras.
    pub node: String,
    /// Folder to write.
    pub out: PathBuf,
    /// Whether photos are written without the distortion of their lens.
    pub undistort: bool,
    /// Number of the run. None for the last one that has the node.
    pub run: Option<u64>,
}

/// Exported cameras.
#[derive(Debug, Serialize)]
pub struct CamerasResult {
    /// Number of the run that wrote them.
    pub run: u64,
    /// The folder.
    pub folder: PathBuf,
    /// The files below it, models first.
    pub files: Vec<String>,
    /// How many photos there are.
    pub photos: usize,
    /// Metres a unit of the scene, if that is known.
    pub metres_per_unit: Option<f64>,
}

/// Writes transforms.json, its points, COLMAP's model, and the photos and masks that they name, at the paths in transforms.json.
///
/// # Errors
/// A run without the node, a place that cannot be written.
pub fn export(context: &Context, request: &CamerasRequest) -> Result<CamerasResult, Error> {
    let store = context.existing_store()?;
    let run = RunChoice::new(context, &store, request.run)?.with_result(&request.node)?;
    let scene = read_scene(&store, node_named(&run, &request.node)?)?;
    let added = AddedNode {
        name: format!("cameras-of-{}", request.node),
        table: json!({"uses": CamerasParams::STAGE, "input": request.node, "undistort": request.undistort}),
    };
    let DerivedRun { session, record } = run_nodes(
        context,
        store,
        &run,
        Purpose::Export,
        std::slice::from_ref(&added),
    )?;
    let all = CameraFiles::from_node(node_named(&record, &added.name)?);
    for (file, digest) in all.every() {
        session.check()?;
        outputs::one(&session.store, &record, digest, &request.out.join(file))?;
    }
    Ok(CamerasResult {
        run: record.number,
        folder: request.out.clone(),
        files: all.every().map(|(file, _)| (*file).to_owned()).collect(),
        photos: all.photos.len(),
        metres_per_unit: scene.metres_per_unit,
    })
}

/// The files of the folder that a node `cameras` made, by their paths below that folder.
#[derive(Debug)]
pub struct CameraFiles<'r> {
    /// The files that name photos, cameras and points.
    pub models: Vec<(&'r str, Digest)>,
    /// The masks of photos.
    pub masks: Vec<(&'r str, Digest)>,
    /// The photos.
    pub photos: Vec<(&'r str, Digest)>,
}

impl<'r> CameraFiles<'r> {
    /// Returns the files that a node made.
    pub fn from_node(node: &'r NodeRun) -> Self {
        let files = node
            .outputs
            .iter()
            .filter_map(|(name, output)| Some((name.strip_prefix(CAMERAS)?, output.digest)));
        let (models, pictures): (Vec<_>, Vec<_>) = files.partition(|(name, _)| is_model(name));
        let (masks, photos) = pictures
            .into_iter()
            .partition(|(name, _)| name.starts_with(MASKS));
        Self {
            models,
            masks,
            photos,
        }
    }

    /// Returns all files, models first.
    fn every(&self) -> impl Iterator<Item = &(&'r str, Digest)> {
        self.models.iter().chain(&self.masks).chain(&self.photos)
    }
}

fn is_model(name: &str) -> bool {
    name == TRANSFORMS || name == POINTS || name.starts_with(SPARSE)
}
