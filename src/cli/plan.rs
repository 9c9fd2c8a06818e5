use marf_engine::{Cancel, Extent, Needs, PlanState, PlannedNode, SharedResults};
use marf_schema::scenes::Scenes;
use marf_stage::Document;
use serde::Serialize;

use super::args::{Global, Selection};
use super::error::CliError;
use super::output::print_json;
use super::scenes;
use super::session::Session;
use super::shared::Shared;
use marf_progress::duration;
use crate::terminal::print_line;

/// A node, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Row<'a> {
    node: &'a str,
    reason: &'a str,
    state: PlanState,
    #[serde(skip_serializing_if = "Option::is_none")]
    extent: Option<Extent>,
    needs: Needs,
}

impl<'a> Row<'a> {
    fn of(planned: &'a PlannedNode) -> Self {
        Self {
            node: &planned.node,
            reason: &planned.reason,
            state: planned.state,
            extent: planned.extent,
            needs: planned.needs,
        }
    }
}

/// `marf plan`: the state of every node and the first thing that changed.
pub fn plan(global: &Global, selection: &Selection, cancel: &Cancel) -> Result<(), CliError> {
    let session = known(Session::open(global, cancel)?, global)?;
    let last = session.last()?;
    let shared = Shared::open(&session, global, cancel)?;
    let shared = shared.as_deref().map(|shared| shared as &dyn SharedResults);
    let (graph, store) = (&session.graph, &session.store);
    let mut nodes = marf_engine::plan_beside(graph, store, last.as_ref(), global.threads, shared)?;
    let (to, from) = scenes::selected(&session, selection)?;
    let chosen = session.graph.select(&to, &from)?;
    nodes.retain(|node| chosen.contains(&node.node));
    if global.json {
        let rows: Vec<Row<'_>> = nodes.iter().map(Row::of).collect();
        return print_json(&rows);
    }
    for node in &nodes {
        print_line(&line(node));
    }
    print_line(&summary(&nodes));
    Ok(())
}

/// Returns how many nodes will run, and how many may.
fn summary(nodes: &[PlannedNode]) -> String {
    let count = |state: PlanState| nodes.iter().filter(|node| node.state == state).count();
    let (will, may) = (count(PlanState::WillRun), count(PlanState::MayRun));
    let will = format!("{will} of {} nodes will run", nodes.len());
    match may {
        0 => will,
        may => format!("{will}; {may} may, if what is upstream of them comes out otherwise than before"),
    }
}

/// Returns the session with its nodes for each scene, as far as they are known without running anything: those that the photos are
/// split into now, or else, where that is to run again, those of the last run.
fn known(session: Session, global: &Global) -> Result<Session, CliError> {
    let Some(by_scene) = &session.by_scene else {
        return Ok(session);
    };
    let last = session.last()?;
    let (graph, store) = (&session.graph, &session.store);
    let nodes = marf_engine::plan(graph, store, last.as_ref(), global.threads)?;
    let split = nodes.iter().find(|node| node.node == by_scene.split);
    let key = split
        .filter(|node| !node.state.is_open())
        .and_then(|node| node.key);
    let record = key.map(|key| session.store.record(&key)).transpose()?.flatten();
    let digest = record.and_then(|record| record.outputs.get(Scenes::OUTPUT).map(|output| output.digest));
    let Some(digest) = digest else {
        return session.for_scenes_of(last.as_ref(), global);
    };
    let scenes = Scenes::decode(&session.store.get(&digest)?)
        .map_err(|error| CliError::failed(format!("{}: {error}", Scenes::OUTPUT)))?;
    session.for_scenes(&scenes, global)
}

/// Returns the line of a node: state, reason, what it will look at, how long it took last.
fn line(node: &PlannedNode) -> String {
    let mut line = format!("{:<16} {:<9} {}", node.node, node.state.word(), node.reason);
    if node.state.is_open() {
        let looks = node.extent.map(|extent| looks_at(&extent));
        let took = node
            .needs
            .seconds
            .map(|seconds| format!("{} last time", duration(seconds)));
        for part in looks.into_iter().chain(took) {
            line.push_str(&format!("; {part}"));
        }
    }
    line.trim_end().to_owned()
}

/// Returns `30 photos of 1 sol`, or `1 sol` where the photos are not fetched yet.
fn looks_at(extent: &Extent) -> String {
    let sols = counted(extent.shards, "sol");
    match extent.photos {
        Some(photos) => format!("{} of {sols}", counted(photos, "photo")),
        None => sols,
    }
}

fn counted(number: u64, what: &str) -> String {
    match number {
        1 => format!("1 {what}"),
        _ => format!("{number} {what}s"),
    }
}

/// `marf why NODE`: everything that differs from what made its last result; with `files` every photo too.
pub fn why(global: &Global, node: &str, files: bool, cancel: &Cancel) -> Result<(), CliError> {
    let session = known(Session::open(global, cancel)?, global)?;
    let last = session.last()?;
    let (graph, store) = (&session.graph, &session.store);
    let mut planned = marf_engine::why(graph, store, last.as_ref(), global.threads, node)?;
    if files {
        let photos = marf_engine::photo_changes(graph, store, last.as_ref(), global.threads, node)?;
        planned.changes.extend(photos);
    }
    if global.json {
        return print_json(&planned);
    }
    print_line(&format!(
        "{} ({}): {}",
        planned.node,
        planned.state.word(),
        planned.reason
    ));
    print_changes(&planned);
    Ok(())
}

fn print_changes(planned: &PlannedNode) {
    if let Some(key) = planned.key {
        print_line(&format!("  key {key}"));
    }
    for change in &planned.changes {
        print_line(&format!("  {change}"));
    }
}
