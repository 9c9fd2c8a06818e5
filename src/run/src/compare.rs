//! Changes at a place between two times.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_cache::Digest;
use marf_config::scenes::scene_of;
use marf_engine::{NodeRun, Purpose, RunRecord};
use marf_schema::calibrate;
use marf_schema::changes::{ChangesParams, ChangesReport};
use marf_schema::output::CHANGE_MAPS;
use marf_stage::Document;
use serde::Serialize;
use serde_json::{Value, json};

use crate::choice::RunChoice;
use crate::context::Context;
use crate::derived::{AddedNode, DerivedRun, run_nodes, table_of};
use crate::error::{Diagnostic, Error};
use crate::outputs;
use crate::session::{Session, digest, node_named};

/// The report among the files.
pub const REPORT: &str = "changes.json";

/// A place to compare at two times.
#[derive(Debug, Clone)]
pub struct CompareRequest {
    /// The scene, where the photos are split by place.
    pub scene: Option<String>,
    /// Folder to write.
    pub out: PathBuf,
    /// Number of the run. None for the last one that has the scene.
    pub run: Option<u64>,
    /// The two times, and how they are compared.
    pub params: ChangesParams,
}

/// The changes, and the files that show them.
#[derive(Debug, Serialize)]
pub struct CompareResult {
    /// The files.
    pub files: Vec<PathBuf>,
    /// Number of the run that compared.
    pub run: u64,
    /// Every change.
    pub changes: ChangesReport,
}

/// Compares a place at two times, unless the store has the result, and writes it.
///
/// # Errors
/// A run without the scene, a comparison that fails, a place that cannot be written.
pub fn compare(context: &Context, request: &CompareRequest) -> Result<CompareResult, Error> {
    let store = context.existing_store()?;
    let scene = request.scene.as_deref();
    let has = |run: &RunRecord| calibrated(run, scene).is_some();
    let choice = RunChoice::new(context, &store, request.run)?;
    let run = choice.newest_with(has, |run| without(run, scene))?;
    let calibrated = calibrated(&run, scene).ok_or_else(|| without(&run, scene))?;
    let added = AddedNode {
        name: format!("changes-of-{}", calibrated.name),
        table: table(request, calibrated)?,
    };
    let DerivedRun { session, record } = run_nodes(
        context,
        store,
        &run,
        Purpose::Comparison,
        std::slice::from_ref(&added),
    )?;
    let node = node_named(&record, &added.name)?;
    Ok(CompareResult {
        changes: session.document(node)?,
        files: write(&session, &record, node, &request.out)?,
        run: record.number,
    })
}

/// Returns the node that placed the photos of a scene. Without a name, of the only scene.
fn calibrated<'r>(run: &'r RunRecord, scene: Option<&str>) -> Option<&'r NodeRun> {
    let mut found = placing(run).filter(|node| scene.is_none() || scene_of(&node.name) == scene);
    let first = found.next()?;
    found.next().is_none().then_some(first)
}

/// Returns the nodes of a run that placed photos.
fn placing(run: &RunRecord) -> impl Iterator<Item = &NodeRun> {
    let good = |node: &&NodeRun| node.parent.is_none() && node.state.is_good();
    run.nodes
        .iter()
        .filter(|node| node.stage == calibrate::Metrics::STAGE)
        .filter(good)
}

fn without(run: &RunRecord, scene: Option<&str>) -> Error {
    let scenes: Vec<&str> = placing(run).filter_map(|node| scene_of(&node.name)).collect();
    let (message, hint) = match (scene, scenes.as_slice()) {
        (Some(scene), []) => (
            format!(
                "run {} does not split its photos by place, so it has no scene `{scene}`",
                run.number
            ),
            "leave the scene out".to_owned(),
        ),
        (Some(scene), scenes) => (
            format!("run {} has no scene `{scene}`", run.number),
            format!("its scenes are {}", scenes.join(", ")),
        ),
        (None, []) => (
            format!("run {} has placed no photos, or more than once", run.number),
            "a pipeline with one node `calibrate` is compared".to_owned(),
        ),
        (None, scenes) => (
            format!("run {} has several scenes", run.number),
            format!("name one: {}", scenes.join(", ")),
        ),
    };
    Error::Usage(Diagnostic::new(message).hint(hint))
}

/// Returns the table of the node, as pipeline.toml would have it.
fn table(request: &CompareRequest, calibrated: &NodeRun) -> Result<Value, Error> {
    let edge = calibrated.edges.iter().find(|edge| edge.key == "input");
    let edge = edge.ok_or_else(|| Error::failed(format!("`{}` read no photos", calibrated.name)))?;
    let photos = match &edge.part {
        Some(part) => format!("{}/{part}", edge.upstream),
        None => edge.upstream.clone(),
    };
    let mut table = table_of(&request.params)?;
    table.insert("input".to_owned(), json!(calibrated.name));
    table.insert("photos".to_owned(), json!(photos));
    Ok(Value::Object(table))
}

fn write(session: &Session, record: &RunRecord, node: &NodeRun, out: &Path) -> Result<Vec<PathBuf>, Error> {
    let outputs = node.outputs.iter();
    let maps = outputs.filter_map(|(name, output)| Some((name.strip_prefix(CHANGE_MAPS)?, output.digest)));
    let mut files: BTreeMap<&str, Digest> = maps.collect();
    files.insert(REPORT, digest(node, ChangesReport::OUTPUT)?);
    let mut written = Vec::new();
    for (file, digest) in files {
        session.check()?;
        let path = out.join(file);
        outputs::one(&session.store, record, &digest, &path)?;
        written.push(path);
    }
    Ok(written)
}
