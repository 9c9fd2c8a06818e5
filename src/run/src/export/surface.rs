//! Files of the surface of a trained field for other programs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use marf_cache::Store;
use marf_engine::{NodeRun, Purpose, RunRecord, run_of};
use marf_model::select;
use marf_schema::output::{DEPTH, MESH_GLB, MESH_PLY, POINTS, SPLAT_VIEWS, SPLATS, SURFACE_MAPS, WEIGHTS};
use marf_schema::surface::{ColorBy, SurfaceParams, SurfaceReport};
use marf_stage::Params;
use serde::Serialize;
use serde_json::{Value, json};

use crate::choice::{RunChoice, has_result};
use crate::context::Context;
use crate::derived::{AddedNode, DerivedRun, run_nodes, table_of};
use crate::error::{Diagnostic, Error};
use crate::outputs;
use crate::session::{bootstraps_of, digest, node_named, read_scene};

/// A surface to export.
#[derive(Debug, Clone)]
pub struct SurfaceRequest {
    /// What is exported.
    pub kind: SurfaceKind,
    /// A node with a trained field.
    pub node: String,
    /// File or folder to write.
    pub out: PathBuf,
    /// Number of the run. None for the last one that has the node.
    pub run: Option<u64>,
    /// How the surface is taken.
    pub params: SurfaceParams,
    /// Of splats, a folder for pictures of them and of the field.
    pub pictures: Option<PathBuf>,
}

/// An exported surface.
#[derive(Debug, Serialize)]
pub struct SurfaceResult {
    /// The files.
    pub files: Vec<PathBuf>,
    /// Number of the run that made it.
    pub run: u64,
    /// The report of the surface.
    pub surface: SurfaceReport,
}

/// What is exported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SurfaceKind {
    /// A mesh, by the ending of the file.
    Mesh,
    /// A cloud of points.
    Points,
    /// Gaussian splats.
    Splats,
    /// Heights, and how far views differ.
    Height,
    /// Colours from above.
    Orthophoto,
    /// Depths at the views of all photos.
    Depth,
}

/// Computes a surface, unless the store has it, and writes it.
///
/// # Errors
/// A run without the field, a surface that the scene does not have, a place that cannot be written.
pub fn export(context: &Context, request: &SurfaceRequest) -> Result<SurfaceResult, Error> {
    let kind = request.kind;
    if kind == SurfaceKind::Splats && request.params.color != ColorBy::default() {
        return Err(Error::usage(
            "splats show the colours of the photos. `export mesh` and `export points` show uncertainty"
                .to_owned(),
        ));
    }
    check_ending(kind, &request.out)?;
    let store = context.existing_store()?;
    let run = run_of_field(context, &store, request)?;
    check_map(kind, &store, node_named(&run, &request.node)?)?;
    let (name, table) = (surface_of(&request.node), table(request, &run)?);
    let DerivedRun { session, record } = made(context, store, &run, table)?;
    let node = node_named(&record, &name)?;
    let surface: SurfaceReport = session.document(node)?;
    check_surface(context, kind, &surface)?;
    let mut files = files_of(kind, node, &request.out);
    let pictures = request.pictures.as_deref();
    files.extend(
        pictures
            .map(|folder| below(node, SPLAT_VIEWS, folder))
            .unwrap_or_default(),
    );
    for (name, path) in &files {
        outputs::one(&session.store, &record, &digest(node, name)?, path)?;
    }
    Ok(SurfaceResult {
        files: files.into_iter().map(|(_, path)| path).collect(),
        run: record.number,
        surface,
    })
}

/// Returns the PLY file of the splats of a field, which are made unless the store has them: those of `export splats`.
///
/// # Errors
/// A run without the field, or a field without a surface.
pub fn splats(context: &Context, run: u64, node: &str) -> Result<Arc<[u8]>, Error> {
    let store = context.existing_store()?;
    let run = run_of(&store, run)?;
    node_named(&run, node)?;
    let table = json!({"uses": SurfaceParams::STAGE, "input": node, "least_photos": 1, "splats": true});
    let DerivedRun { session, record } = made(context, store, &run, table)?;
    let splats = digest(node_named(&record, &surface_of(node))?, SPLATS)?;
    Ok(session.store.get(&splats)?)
}

fn surface_of(trained: &str) -> String {
    format!("surface-of-{trained}")
}

/// Runs a node `surface` of this table, which reads `input`.
fn made(context: &Context, store: Store, run: &RunRecord, table: Value) -> Result<DerivedRun, Error> {
    let trained = table["input"].as_str().unwrap_or_default();
    let name = surface_of(trained);
    run_nodes(context, store, run, Purpose::Export, &[AddedNode { name, table }])
}

/// What gives a scene a scale and an up direction.
const METRES: &str = "cameras from labels (`method = \"sfm\"` or \"labels\" on photos with labels) give metres and an up direction";

/// Refuses a map of a field whose scene has no metres or no up, before anything is computed.
fn check_map(kind: SurfaceKind, store: &Store, trained: &NodeRun) -> Result<(), Error> {
    let what = match kind {
        SurfaceKind::Height => "the height map",
        SurfaceKind::Orthophoto => "the orthophoto",
        _ => return Ok(()),
    };
    let scene = read_scene(store, trained)?;
    let why = match (scene.metres_per_unit, scene.up) {
        (None, _) => "the scene has no scale, so lengths in metres are unknown",
        (_, None) => "the scene does not know where up is",
        _ => return Ok(()),
    };
    Err(Error::Failed(
        Diagnostic::new(format!("{what} cannot be made: {why}")).hint(METRES),
    ))
}

/// What leaves a surface empty.
const EMPTY: &str = "lower --least-photos, or widen --most-spread or --cell: points with too few or differing photos are left out";

/// Refuses a map that the surface does not have, and warns of a surface without a triangle or point.
fn check_surface(context: &Context, kind: SurfaceKind, report: &SurfaceReport) -> Result<(), Error> {
    let is_map = matches!(kind, SurfaceKind::Height | SurfaceKind::Orthophoto);
    if let Some(why) = report.refused.get(SURFACE_MAPS).filter(|_| is_map) {
        let diagnostic = Diagnostic::new(why.clone());
        let is_empty = report.triangles == 0;
        return Err(Error::Failed(if is_empty {
            diagnostic.hint(EMPTY)
        } else {
            diagnostic
        }));
    }
    match kind {
        SurfaceKind::Mesh if report.triangles == 0 => {
            context.warn(format!("the mesh has no triangle: {EMPTY}"))
        }
        SurfaceKind::Points if report.points == 0 => context.warn(format!("the cloud has no point: {EMPTY}")),
        _ => {}
    }
    Ok(())
}

/// Returns the run whose field is exported.
fn run_of_field(context: &Context, store: &Store, request: &SurfaceRequest) -> Result<RunRecord, Error> {
    let retrained = |run: &RunRecord, node: &str| bootstraps_of(run, node).any(|node| node.state.is_good());
    let node = &request.node;
    let choice = RunChoice::new(context, store, request.run)?;
    let run = choice.with_result(node)?;
    if request.run.is_some() || !has_members(request.kind) || retrained(&run, node) {
        return Ok(run);
    }
    // Uncertainty needs a bootstrap. The bootstrap of an older field is only used for an export with uncertainty.
    let weights = |run: &RunRecord| Some(run.node(node)?.outputs.get(WEIGHTS)?.digest);
    let is_same =
        |other: &RunRecord| request.params.color != ColorBy::default() || weights(other) == weights(&run);
    let both = |run: &RunRecord| has_result(run, node) && is_same(run) && retrained(run, node);
    let with_members = select::newest_with(store, &choice.subject, context.warnings(), both)?;
    Ok(with_members.unwrap_or(run))
}

/// Returns whether an export shows how far the retrainings of a bootstrap differ.
fn has_members(kind: SurfaceKind) -> bool {
    matches!(kind, SurfaceKind::Mesh | SurfaceKind::Points)
}

/// Refuses an ending that says something else than what is written.
fn check_ending(kind: SurfaceKind, out: &Path) -> Result<(), Error> {
    let endings: &[&str] = match kind {
        SurfaceKind::Mesh => &["ply", "glb"],
        SurfaceKind::Points | SurfaceKind::Splats => &["ply"],
        SurfaceKind::Height | SurfaceKind::Orthophoto => &["png", "tif"],
        SurfaceKind::Depth => return Ok(()),
    };
    let ending = out
        .extension()
        .and_then(|ending| ending.to_str())
        .unwrap_or_default();
    if endings.contains(&ending) {
        return Ok(());
    }
    Err(Error::usage(format!(
        "--out {}: the file must end with .{}",
        out.display(),
        endings.join(" or .")
    )))
}

/// Returns the table of the node, as pipeline.toml would have it.
fn table(request: &SurfaceRequest, run: &RunRecord) -> Result<Value, Error> {
    let mut table = table_of(&request.params)?;
    table.insert("input".to_owned(), json!(request.node));
    let mut members = bootstraps_of(run, &request.node).filter(|node| node.state.is_good());
    if let Some(node) = members.next().filter(|_| has_members(request.kind)) {
        table.insert("members".to_owned(), json!(node.name));
    }
    Ok(Value::Object(table))
}

/// Returns the outputs to write, and where to.
fn files_of(kind: SurfaceKind, node: &NodeRun, out: &Path) -> Vec<(String, PathBuf)> {
    let is_glb = out.extension().is_some_and(|ending| ending == "glb");
    let is_tiff = out.extension().is_some_and(|ending| ending == "tif");
    let map = |name: &str, ending: &str| format!("{SURFACE_MAPS}{name}.{ending}");
    match kind {
        SurfaceKind::Mesh if is_glb => vec![(MESH_GLB.to_owned(), out.to_owned())],
        SurfaceKind::Mesh => vec![(MESH_PLY.to_owned(), out.to_owned())],
        SurfaceKind::Points => vec![(POINTS.to_owned(), out.to_owned())],
        SurfaceKind::Splats => vec![(SPLATS.to_owned(), out.to_owned())],
        SurfaceKind::Height if is_tiff => vec![
            (map("height", "tif"), out.to_owned()),
            (map("spread", "tif"), beside(out, "-spread")),
        ],
        SurfaceKind::Height => {
            let spread = beside(out, "-spread");
            vec![
                (map("height", "png"), out.to_owned()),
                (map("height", "pgw"), out.with_extension("pgw")),
                (map("spread", "pgw"), spread.with_extension("pgw")),
                (map("spread", "png"), spread),
            ]
        }
        SurfaceKind::Orthophoto if is_tiff => vec![(map("orthophoto", "tif"), out.to_owned())],
        SurfaceKind::Orthophoto => vec![
            (map("orthophoto", "png"), out.to_owned()),
            (map("orthophoto", "pgw"), out.with_extension("pgw")),
        ],
        SurfaceKind::Depth => below(node, DEPTH, out),
    }
}

/// Returns the outputs of a node whose names begin with a prefix, and their files in a folder.
fn below(node: &NodeRun, prefix: &str, folder: &Path) -> Vec<(String, PathBuf)> {
    let names = node.outputs.keys();
    let files = names.filter_map(|name| Some((name.clone(), folder.join(name.strip_prefix(prefix)?))));
    files.collect()
}

/// Returns the file next to another whose stem ends with `more`.
fn beside(file: &Path, more: &str) -> PathBuf {
    let [stem, ending] =
        [file.file_stem(), file.extension()].map(|part| part.unwrap_or_default().to_string_lossy());
    file.with_file_name(format!("{stem}{more}.{ending}"))
}
