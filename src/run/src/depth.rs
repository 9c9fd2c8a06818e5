//! Makes depths, points and maps of a folder's photos, without a field.

use std::path::PathBuf;

use marf_engine::NodeRun;
use marf_schema::calibrate::{self, CalibrateParams};
use marf_schema::depth::{DepthParams, Metrics};
use marf_schema::output::{POINTS, SURFACE_MAPS};
use marf_stage::{Document, Params};

use crate::context::Context;
use crate::error::Error;
use crate::execute::{execute, options};
use crate::folder::{self, PhotoFolder};
use crate::outputs;
use crate::session::{Session, node_named};

/// A folder whose depths are wanted.
#[derive(Debug, Clone)]
pub struct DepthRequest {
    /// The folder, or a transforms.json.
    pub dir: PathBuf,
    /// Folder to write.
    pub out: PathBuf,
    /// Where cameras come from, as pipeline.toml names it.
    pub method: String,
}

/// The depths of a folder's photos.
#[derive(Debug, Clone)]
pub struct DepthResult {
    /// How well the cameras fit.
    pub cameras: calibrate::Metrics,
    /// How much of the photos has a depth.
    pub metrics: Metrics,
    /// Seconds of the stage. Those of the run that computed it.
    pub seconds: f64,
    /// The files, pictures of photos aside.
    pub written: Vec<PathBuf>,
}

/// Writes depths, their standard deviations and classes as a picture a photo, a cloud of points, and maps where the scene has metres and an
/// up direction.
///
/// # Errors
/// A folder that cannot be read or written, photos whose cameras are not found.
pub fn depth(context: &Context, request: &DepthRequest) -> Result<DepthResult, Error> {
    let photos = PhotoFolder::new(&request.dir)?;
    let text = format!(
        "{}[node.depth]\ninput = \"calibrate\"\n",
        photos.calibration("depth", &request.method)
    );
    let session = Session::implicit(context, &text, "depth", &request.dir)?;
    let record = execute(&session, &options(&session))?
        .done()
        .map_err(folder::for_folder)?;
    let node = node_named(&record, DepthParams::STAGE)?;
    let mut written = Vec::new();
    for (name, output) in &node.outputs {
        let path = request.out.join(file_name(name));
        outputs::one(&session.store, &record, &output.digest, &path)?;
        if !is_of_photo(name) {
            written.push(path);
        }
    }
    Ok(DepthResult {
        cameras: session.document(node_named(&record, CalibrateParams::STAGE)?)?,
        metrics: session.document(node)?,
        seconds: seconds(&session, node),
        written,
    })
}

/// Returns the file that an output becomes.
fn file_name(name: &str) -> &str {
    if name == Metrics::OUTPUT {
        "depth.json"
    } else {
        name
    }
}

fn is_of_photo(name: &str) -> bool {
    name != Metrics::OUTPUT && name != POINTS && !name.starts_with(SURFACE_MAPS)
}

fn seconds(session: &Session, node: &NodeRun) -> f64 {
    let made = node.key.and_then(|key| session.store.record(&key).ok().flatten());
    made.map_or(node.seconds, |record| record.metadata.seconds)
}
