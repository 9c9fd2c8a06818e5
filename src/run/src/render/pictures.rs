//! Pictures of a trained field along a path, and a film of them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use marf_cache::{Digest, Store};
use marf_engine::{NodeRun, Purpose, RunRecord};
use marf_scene::Scene;
use marf_schema::output::{
    DEPTH, DEPTH_PREVIEW, FRAMES, SCENE, UNCERTAINTY, UNCERTAINTY_PREVIEW, VIDEO, WEIGHTS,
};
use marf_schema::render::{Layer, Poses, RenderParams};
use marf_schema::video::VideoParams;
use marf_stage::{Document, Params};
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::path::{self, CameraPath};
use super::size::SizeRequest;
use crate::choice::{RunChoice, has_result};
use crate::context::Context;
use crate::derived::{AddedNode, DerivedRun, run_nodes};
use crate::error::{Diagnostic, Error};
use crate::export_table::ExportTable;
use crate::session::{Session, bootstraps_of, digest, node_named, read_scene};

/// A field to render, and how.
#[derive(Debug, Clone)]
pub struct RenderRequest {
    /// A node with a trained field.
    pub node: String,
    /// Number of the run. None for the last one that has the node.
    pub run: Option<u64>,
    /// The camera path: a word, or a file of bookmarks.
    pub path: String,
    /// The outputs at every viewpoint.
    pub outputs: Vec<Layer>,
    /// Folder to write.
    pub out: PathBuf,
    /// Pictures along the path. None for the default of the path or the stage.
    pub frames: Option<u32>,
    /// Size of the pictures.
    pub size: SizeRequest,
    /// Pictures a second in the film.
    pub fps: u32,
    /// Quantiser of the film.
    pub quantizer: u32,
}

/// What was rendered.
#[derive(Debug, Serialize)]
pub struct RenderResult {
    /// The files.
    pub files: Vec<PathBuf>,
    /// How many pictures there are of each kind.
    pub pictures: usize,
    /// Width of a picture, pixels.
    pub width: u32,
    /// Height of a picture, pixels.
    pub height: u32,
    /// Number of the run that rendered.
    pub run: u64,
    /// Whether there is a film.
    #[serde(skip)]
    pub has_film: bool,
    /// Metres a unit of the scene, if that is known.
    #[serde(skip)]
    pub metres_per_unit: Option<f64>,
}

/// Folders of the pictures below `--out`, by output of the node.
const FOLDERS: [(&str, &str); 5] = [
    (FRAMES, "rgb"),
    (DEPTH, "depth"),
    (DEPTH_PREVIEW, "depth-preview"),
    (UNCERTAINTY, "uncertainty"),
    (UNCERTAINTY_PREVIEW, "uncertainty-preview"),
];
/// The film below `--out`.
pub const FILM: &str = "video.mp4";

/// Renders a field, unless the store has the pictures, and writes them.
///
/// # Errors
/// A path or a run that is not there, a rendering that fails, a place that cannot be written.
pub fn render(context: &Context, request: &RenderRequest) -> Result<RenderResult, Error> {
    let bookmarks = path::read(&request.path, request.frames)?;
    let store = context.existing_store()?;
    let run = run_of(&RunChoice::new(context, &store, request.run)?, request)?;
    let trained = &request.node;
    let scene = scene_of(&store, &run, trained)?;
    if let Some(other) = bookmarks.of_other_scene(&digest(node_named(&run, trained)?, SCENE)?) {
        context.warn(other);
    }
    let path = &bookmarks.path;
    let (pictures, film) = (format!("render-of-{trained}"), format!("video-of-{trained}"));
    let mut nodes = vec![AddedNode {
        name: pictures.clone(),
        table: table(request, path, &scene, &run, trained)?,
    }];
    nodes.extend(path.has_film().then(|| AddedNode {
        name: film.clone(),
        table: film_table(request, &pictures),
    }));
    let DerivedRun { session, record } = run_nodes(context, store, &run, Purpose::Render, &nodes)?;
    let node = node_named(&record, &pictures)?;
    let film = path.has_film().then(|| node_named(&record, &film)).transpose()?;
    let files = write(&session, &record, node, film, &request.out)?;
    let Poses(poses) = session.document(node)?;
    let camera = poses.first().map(|place| &place.camera);
    Ok(RenderResult {
        files,
        pictures: poses.len(),
        width: camera.map_or(0, |camera| camera.width),
        height: camera.map_or(0, |camera| camera.height),
        run: record.number,
        has_film: path.has_film(),
        metres_per_unit: scene.metres_per_unit,
    })
}

/// Returns the run whose field is rendered, with a bootstrap for uncertainty.
fn run_of(choice: &RunChoice<'_>, request: &RenderRequest) -> Result<RunRecord, Error> {
    let trained = request.node.as_str();
    let run = choice.with_result(trained)?;
    if !request.outputs.contains(&Layer::Uncertainty) {
        return Ok(run);
    }
    let has = |run: &RunRecord| has_result(run, trained) && bootstrap_of(run, trained).is_some();
    choice.newest_with(has, |run| {
        let message = format!(
            "run {} has no bootstrap of `{trained}`, and the uncertainty is how far its retrainings differ",
            run.number
        );
        Error::Usage(Diagnostic::new(message).hint(format!(
            "add `[node.bootstrap]` with `training = \"{trained}\"` to pipeline.toml and run it, or leave `uncertainty` out"
        )))
    })
}

/// Returns the name of a bootstrap that has retrained a field.
fn bootstrap_of<'r>(run: &'r RunRecord, trained: &str) -> Option<&'r str> {
    let mut good = bootstraps_of(run, trained).filter(|node| node.state.is_good());
    good.next().map(|node| node.name.as_str())
}

fn scene_of(store: &Store, run: &RunRecord, trained: &str) -> Result<Scene, Error> {
    let node = node_named(run, trained)?;
    if !node.outputs.contains_key(WEIGHTS) {
        let message = format!("`{trained}` of run {} gives no trained field", run.number);
        return Err(Error::Usage(
            Diagnostic::new(message).hint("name a node of the stage `train`"),
        ));
    }
    read_scene(store, node)
}

/// Returns the table of the node that renders, as pipeline.toml would have it.
fn table(
    request: &RenderRequest,
    path: &CameraPath,
    scene: &Scene,
    run: &RunRecord,
    trained: &str,
) -> Result<Value, Error> {
    let mut table = Map::from_iter([
        ("uses".to_owned(), json!(RenderParams::STAGE)),
        ("input".to_owned(), json!(trained)),
        ("outputs".to_owned(), json!(request.outputs)),
    ]);
    let bootstrap = bootstrap_of(run, trained).filter(|_| request.outputs.contains(&Layer::Uncertainty));
    let size = request
        .size
        .keys(path.natural_size(scene), path.default_width())?;
    let keys = [
        ("members", bootstrap.map(|name| json!(name))),
        (
            "frames",
            path.frames(request.frames, scene).map(|count| json!(count)),
        ),
        ("width", size.width.map(|width| json!(width))),
        ("height", size.height.map(|height| json!(height))),
    ];
    let given = keys.into_iter().filter_map(|(key, value)| Some((key, value?)));
    table.extend(
        given
            .chain(path.keys())
            .map(|(key, value)| (key.to_owned(), value)),
    );
    Ok(Value::Object(table))
}

/// Returns the table of the node that encodes.
fn film_table(request: &RenderRequest, pictures: &str) -> Value {
    json!({
        "uses": VideoParams::STAGE,
        "input": pictures,
        "fps": request.fps,
        "quantizer": request.quantizer,
    })
}

/// Writes pictures, poses and film, and removes those of an earlier call that nobody touched.
fn write(
    session: &Session,
    record: &RunRecord,
    node: &NodeRun,
    film: Option<&NodeRun>,
    out: &Path,
) -> Result<Vec<PathBuf>, Error> {
    let mut table = ExportTable::load(&session.store, out, record.root);
    let written = write_all(session, &mut table, node, film);
    table.save();
    Ok(written?.into_iter().map(|file| out.join(file)).collect())
}

fn write_all(
    session: &Session,
    table: &mut ExportTable,
    node: &NodeRun,
    film: Option<&NodeRun>,
) -> Result<Vec<PathBuf>, Error> {
    let mut files: Vec<(PathBuf, Digest)> = vec![(PathBuf::from("poses.json"), digest(node, Poses::OUTPUT)?)];
    if let Some(film) = film {
        files.push((PathBuf::from(FILM), digest(film, VIDEO)?));
    }
    for (prefix, folder) in FOLDERS {
        let below = node
            .outputs
            .iter()
            .filter_map(|(name, output)| Some((name.strip_prefix(prefix)?, output.digest)));
        let below: Vec<(&str, Digest)> = below.collect();
        let names: BTreeSet<String> = below.iter().map(|(name, _)| (*name).to_owned()).collect();
        table.keep_only(Path::new(folder), &names)?;
        files.extend(
            below
                .iter()
                .map(|(name, digest)| (Path::new(folder).join(name), *digest)),
        );
    }
    table.remove(Path::new(""), |name| name == FILM && film.is_none())?;
    for (file, digest) in &files {
        session.check()?;
        table.write(file, digest, || Ok::<_, Error>(session.store.get(digest)?))?;
    }
    Ok(files.into_iter().map(|(file, _)| file).collect())
}
