//! `marf render`: pictures of a trained field along a path, and a film of them.

mod path;
mod size;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use marf_cache::{Digest, Store};
use marf_engine::{Cancel, NodeRun, RunRecord};
use marf_scene::Scene;
use marf_schema::output::{
    DEPTH, DEPTH_PREVIEW, FRAMES, SCENE, UNCERTAINTY, UNCERTAINTY_PREVIEW, VIDEO, WEIGHTS,
};
use marf_schema::render::{Layer, Poses, RenderParams};
use marf_schema::video::{Codec, VideoParams};
use marf_stage::{Document, Params};
use serde_json::{Map, Value, json};

use super::again::{Added, run_nodes, run_where, without};
use super::args::Global;
use super::error::{CliError, Diagnostic};
use super::export_table::ExportTable;
use super::field_file;
use super::output::print_json;
use super::session::{Session, bootstraps_of, digest, existing_store, node_named, warn};
use crate::terminal::print_line;
use path::CameraPath;
use size::SizeArgs;

/// Arguments of `render`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct RenderArgs {
    /// A node with a trained field
    #[arg(value_name = "NODE", default_value = "train")]
    pub node: String,
    /// The field in this file instead, as a run of the store made it (`out/train/weights.safetensors`)
    #[arg(long, value_name = "FILE", conflicts_with = "node")]
    pub field: Option<PathBuf>,
    /// Number of the run [default: the last one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Where the camera goes: `train` or `heldout` (to the photos), `interp` (smoothly through those of the training), `orbit`, or a
    /// FILE of bookmarks
    #[arg(long, value_name = "PATH|FILE", default_value = "interp")]
    pub path: String,
    /// What is made at every viewpoint: `rgb`, `depth`, `uncertainty`
    #[arg(long, value_name = "WHAT", value_delimiter = ',', default_value = "rgb", value_parser = layer)]
    pub output: Vec<Layer>,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Pictures along the path [default: 96; all photos for `train` and `heldout`; one still a bookmark for a FILE]
    #[arg(long, value_name = "COUNT")]
    pub frames: Option<u32>,
    /// Size of the pictures
    #[command(flatten)]
    pub size: SizeArgs,
    /// Pictures a second in the film
    #[arg(long, value_name = "RATE", default_value_t = VideoParams::default().fps)]
    pub fps: u32,
    /// How the film is encoded: `h264`, or `av1`, whose makers license their patents without fees and which takes longer
    #[arg(long, value_name = "CODEC", default_value = "h264", value_parser = codec)]
    pub codec: Codec,
    /// Quantiser of the film, 12 (finest, largest) to 51
    #[arg(long, value_name = "QP", default_value_t = VideoParams::default().quantizer)]
    pub quantizer: u32,
}

const AFTER_HELP: &str = "\
DIR gets rgb/0001.png, depth/ and uncertainty/ (PNG of 16 bits, the scale in their text) with a preview in colours each, poses.json, and \
video.mp4 with all outputs side by side. A FILE is what `marf view` saves as bookmarks, or the poses.json of another render: \
without --frames it gives one still each, with --frames a smooth path through them. What was rendered is kept: the same call again only \
copies, and a call that was stopped goes on.";

/// Reads an output as pipeline.toml has it.
fn layer(word: &str) -> Result<Layer, String> {
    serde_json::from_value(json!(word)).map_err(|error| error.to_string())
}

/// Reads a codec as pipeline.toml has it.
fn codec(word: &str) -> Result<Codec, String> {
    serde_json::from_value(json!(word)).map_err(|error| error.to_string())
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
const FILM: &str = "video.mp4";

/// Renders what is wanted, unless it is rendered already, and writes it.
pub fn render(global: &Global, args: &RenderArgs, cancel: &Cancel) -> Result<(), CliError> {
    let path = path::read(&args.path, args.frames)?;
    let store = existing_store(global, cancel)?;
    let (trained, runs) = match &args.field {
        Some(file) => field_file::made_by(&store, file, args.run)?,
        None => (args.node.clone(), Vec::new()),
    };
    let run = run_of(&store, args, &trained, &runs)?;
    let scene = scene_of(&store, &run, &trained)?;
    if let Some(other) = path.of_other_scene(&digest(node_named(&run, &trained)?, SCENE)?) {
        warn(other);
    }
    let (pictures, film) = (format!("render-of-{trained}"), format!("video-of-{trained}"));
    let mut nodes: Vec<Added<'_>> = vec![(&pictures, table(args, &path, &scene, &run, &trained)?)];
    if path.has_film() {
        nodes.push((&film, film_table(args, &pictures)));
    }
    let has_film = nodes.len() > 1;
    let (session, record) = run_nodes(store, &run, &nodes, global, cancel)?;
    let node = node_named(&record, &pictures)?;
    let film = has_film.then(|| node_named(&record, &film)).transpose()?;
    let written = write(&session, &record, node, film, &args.out)?;
    let Poses(poses) = session.document(node)?;
    let size = poses
        .first()
        .map_or((0, 0), |place| (place.camera.width, place.camera.height));
    if global.json {
        return print_json(&json!({
            "files": written,
            "pictures": poses.len(),
            "width": size.0,
            "height": size.1,
            "run": record.number,
        }));
    }
    print_line(&text(args, poses.len(), size, scene.metres_per_unit));
    print_line(&format!(
        "wrote {} files to {}{}",
        written.len(),
        args.out.display(),
        if has_film {
            format!(", {FILM} among them")
        } else {
            String::new()
        }
    ));
    Ok(())
}

/// Returns the run whose field is rendered, one of some if there are any, with a bootstrap of it if its uncertainty is asked for.
fn run_of(store: &Store, args: &RenderArgs, trained: &str, runs: &[u64]) -> Result<RunRecord, CliError> {
    let has_field = |run: &RunRecord| {
        let is_trained = run.node(trained).is_some_and(|node| node.state.is_good());
        is_trained && (runs.is_empty() || runs.contains(&run.number))
    };
    let run = run_where(store, args.run, has_field, |run| without(run, trained))?;
    if !args.output.contains(&Layer::Uncertainty) {
        return Ok(run);
    }
    let has = |run: &RunRecord| has_field(run) && bootstrap_of(run, trained).is_some();
    run_where(store, args.run, has, |run| {
        let message = format!(
            "run {} has no bootstrap of `{trained}`, and the uncertainty is how far its retrainings differ",
            run.number
        );
        CliError::Usage(Diagnostic::new(message).hint(format!(
            "add `[node.bootstrap]` with `of = \"{trained}\"` to pipeline.toml and run it, or leave `uncertainty` out"
        )))
    })
}

/// Returns the name of a bootstrap that has retrained a field.
fn bootstrap_of<'r>(run: &'r RunRecord, trained: &str) -> Option<&'r str> {
    let mut good = bootstraps_of(run, trained).filter(|node| node.state.is_good());
    good.next().map(|node| node.name.as_str())
}

fn scene_of(store: &Store, run: &RunRecord, trained: &str) -> Result<Scene, CliError> {
    let node = node_named(run, trained)?;
    if !node.outputs.contains_key(WEIGHTS) {
        let message = format!("`{trained}` of run {} gives no trained field", run.number);
        return Err(CliError::Usage(
            Diagnostic::new(message).hint("name a node of the stage `train`"),
        ));
    }
    let scene = Scene::decode(&store.get(&digest(node, SCENE)?)?);
    scene.map_err(|error| CliError::failed(error.to_string()))
}

/// Returns the table of the node that renders, as pipeline.toml would have it.
fn table(
    args: &RenderArgs,
    path: &CameraPath,
    scene: &Scene,
    run: &RunRecord,
    trained: &str,
) -> Result<Value, CliError> {
    let mut table = Map::from_iter([
        ("uses".to_owned(), json!(RenderParams::STAGE)),
        ("input".to_owned(), json!(trained)),
        ("outputs".to_owned(), json!(args.output)),
    ]);
    let bootstrap = bootstrap_of(run, trained).filter(|_| args.output.contains(&Layer::Uncertainty));
    let (width, height) = args.size.of(path.natural_size(scene), path.default_width())?;
    let keys = [
        ("members", bootstrap.map(|name| json!(name))),
        (
            "frames",
            path.frames(args.frames, scene).map(|count| json!(count)),
        ),
        ("width", width.map(|width| json!(width))),
        ("height", height.map(|height| json!(height))),
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
fn film_table(args: &RenderArgs, pictures: &str) -> Value {
    json!({
        "uses": VideoParams::STAGE,
        "input": pictures,
        "codec": args.codec,
        "fps": args.fps,
        "quantizer": args.quantizer,
    })
}

/// Writes pictures, poses and film, and removes those of an earlier call that nobody touched.
fn write(
    session: &Session,
    record: &RunRecord,
    node: &NodeRun,
    film: Option<&NodeRun>,
    out: &Path,
) -> Result<Vec<PathBuf>, CliError> {
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
) -> Result<Vec<PathBuf>, CliError> {
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
        table.write(file, digest, || Ok::<_, CliError>(session.store.get(digest)?))?;
    }
    Ok(files.into_iter().map(|(file, _)| file).collect())
}

/// Says what was made.
fn text(args: &RenderArgs, pictures: usize, (width, height): (u32, u32), metres: Option<f64>) -> String {
    let words = args.output.iter().map(|layer| match layer {
        Layer::Rgb => "colour",
        Layer::Depth if metres.is_some() => "depth in metres",
        Layer::Depth => "depth in units of the scene, whose scale is not known",
        Layer::Uncertainty => "uncertainty (standard deviation of gray, white = 1)",
    });
    let words: Vec<&str> = words.collect();
    format!(
        "{pictures} viewpoints of {width} x {height} pixels: {}",
        words.join(", ")
    )
}
