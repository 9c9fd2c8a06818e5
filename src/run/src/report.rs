//! The report of a run, and the pages of its scenes.

use std::path::Path;
use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_engine::{NodeState, Purpose, RunRecord, document};
use marf_export::iso_time;
use marf_model::{Run, select};
use marf_report::trade::Trade;
use marf_report::{ChangedNode, Changes, ChildView, NodeView, ReportInput, SceneView, State};
use marf_stage::Memos;

use crate::context::Context;
use crate::diff::{self, RunNames};
use crate::documents::{self, Documents};
use crate::error::Error;
use crate::session::Session;
use crate::{files, outputs, scenes};

/// Writes the report of the last run: the one that the run kept, or for a run without one a new one. Without a pipeline file, the report of the
/// newest verb on a folder.
///
/// # Errors
/// A pipeline that has not run, a store that cannot be read, a place that cannot be written.
pub fn report(context: &Context, out: &Path) -> Result<(), Error> {
    if !context.file.is_file() {
        return outputs::report(context, out);
    }
    let session = Session::open(context)?;
    let record = session
        .last()?
        .ok_or_else(|| Error::failed(format!("`{}` has not run yet", session.name)))?;
    let session = session.for_scenes_of(Some(&record))?;
    let kept = record.documents.get(document::REPORT);
    match kept.filter(|kept| session.store.contains(&kept.digest)) {
        Some(kept) => outputs::one(&session.store, &record, &kept.digest, out),
        None => files::write(out, page(&session, &record)?.as_bytes()),
    }
}

/// Stores the report of a run, and a page for each of its scenes; those of the last run stay where nothing ran.
///
/// # Errors
/// A store that cannot be read or written.
pub fn documents(session: &Session, record: &RunRecord) -> Result<Documents, Error> {
    let all = session.scenes.iter().map(|scene| Some(scene.as_str()));
    let page = |scene: Option<&str>| {
        let name = scene.map_or(document::REPORT.to_owned(), scenes::page_name);
        let is_shown = |node: &str| scene.is_none() || scenes::is_of(node, scene);
        match documents::unchanged(session, record, &name, is_shown)? {
            Some(kept) => Ok((name, kept)),
            None => documents::put(session, &name, page_of(session, record, scene)?.as_bytes()),
        }
    };
    std::iter::once(None).chain(all).map(page).collect()
}

/// Returns the report of a run.
///
/// # Errors
/// A store that cannot be read or written, the wish to stop.
pub fn page(session: &Session, record: &RunRecord) -> Result<String, Error> {
    page_of(session, record, None)
}

/// Returns the report of a run: of one of its scenes, or of what all share with a list of the scenes.
fn page_of(session: &Session, record: &RunRecord, scene: Option<&str>) -> Result<String, Error> {
    // Who wants to stop reads nothing any more, and what was read until then becomes no report.
    let read = |digest: &Digest| -> Option<Arc<[u8]>> {
        session.check().ok()?;
        session.store.get(digest).ok()
    };
    // Pictures of the page are kept as long as the last result it shows.
    let maker = record
        .nodes
        .iter()
        .rev()
        .find_map(|node| node.key)
        .unwrap_or_else(|| Digest::from_content(&[]));
    let all = nodes(session, record)?;
    let of = |scene: Option<&str>| -> Vec<NodeView> {
        let shown = all.iter().filter(|node| scenes::is_of(&node.name, scene));
        let linked = |node: &NodeView| match scene {
            Some(_) => node.clone(),
            None => linked_past_scenes(&all, node),
        };
        shown.map(linked).collect()
    };
    let listed = session.scenes.iter().filter(|_| scene.is_none());
    let input = ReportInput {
        pipeline: match scene {
            None => record.pipeline.clone(),
            Some(scene) => format!("{}, {scene}", record.pipeline),
        },
        command: record.command.clone(),
        started: iso_time(record.started_unix_s),
        program: record.program.clone(),
        nodes: of(scene),
        whole: scene.map(|_| format!("../{}", document::REPORT)),
        scenes: listed
            .map(|scene| SceneView {
                name: scene.clone(),
                page: scenes::page_name(scene),
                nodes: of(Some(scene.as_str())),
            })
            .collect(),
        changes: changes(session, record, |node| {
            scene.is_none() || scenes::is_of(node, scene)
        })?,
        trade: trade(session, record)?.filter(|_| scene.is_none()),
        read: &read,
        memos: &StoreMemos(&session.store, maker),
    };
    let page = marf_report::write(&input);
    session.check()?;
    session.store.commit()?;
    Ok(page)
}

/// Returns a node that all scenes share with what it reads of scenes replaced by what these read, which is on the same page.
fn linked_past_scenes(all: &[NodeView], node: &NodeView) -> NodeView {
    let mut upstream: Vec<(String, String)> = Vec::new();
    let mut open: Vec<&(String, String)> = node.upstream.iter().rev().collect();
    while let Some(edge) = open.pop() {
        let of_scene = all
            .iter()
            .find(|one| one.name == edge.1 && !scenes::is_of(&one.name, None));
        match of_scene {
            Some(node) => open.extend(node.upstream.iter().rev()),
            None if upstream.iter().all(|(_, name)| *name != edge.1) => upstream.push(edge.clone()),
            None => {}
        }
    }
    NodeView {
        upstream,
        ..node.clone()
    }
}

/// Returns what changed since the last run of the pipeline with other results, so that a run that does nothing has what the one
/// before it has; children of nodes are left out.
///
/// # Errors
/// A store that cannot be read, the wish to stop.
fn changes(
    session: &Session,
    record: &RunRecord,
    is_shown: impl Fn(&str) -> bool,
) -> Result<Option<Changes>, Error> {
    session.check()?;
    let Some(before) = session.before(record)? else {
        return Ok(None);
    };
    let since = before.number;
    let parents = |run: RunRecord| -> Result<_, Error> {
        let mut lineage = Run::new(&session.store, run)?;
        lineage
            .nodes
            .retain(|node| !node.is_child() && is_shown(&node.run.name));
        Ok(lineage)
    };
    let nodes = diff::compare(&parents(before)?, &parents(record.clone())?, diff::MOST)?;
    let runs = RunNames {
        first: format!("run {since}"),
        second: "this run".to_owned(),
    };
    let changed = |node: &diff::NodeChanges| ChangedNode {
        heading: node.heading(&runs),
        lines: node.lines(),
    };
    Ok(Some(Changes {
        since,
        nodes: nodes.iter().map(changed).collect(),
    }))
}

/// Returns the last trade that was measured around the pipeline of a run.
///
/// # Errors
/// A store that cannot be read.
fn trade(session: &Session, record: &RunRecord) -> Result<Option<Trade>, Error> {
    let warnings = session.context.warnings();
    let run = select::newest_derived(&session.store, record, Purpose::Trade, warnings, |run| {
        run.documents.contains_key(document::TRADE)
    })?;
    let kept = run.and_then(|run| run.documents.get(document::TRADE).copied());
    let bytes = kept.map(|kept| session.store.get(&kept.digest)).transpose()?;
    let read = |bytes: Arc<[u8]>| serde_json::from_slice(&bytes);
    let trade = bytes.map(read).transpose();
    trade.map_err(|error| Error::failed(format!("{}: {error}", document::TRADE)))
}

/// Memos in the store, and the key they are kept for; a lost one costs only time.
struct StoreMemos<'a>(&'a Store, Digest);

impl Memos for StoreMemos<'_> {
    fn load(&self, key: &Digest) -> Option<Arc<[u8]>> {
        let blob = self.0.memo(key).ok()??;
        self.0.get(&blob).ok()
    }

    fn save(&self, key: &Digest, table: &[u8]) {
        if let Ok(blob) = self.0.put(table) {
            self.0.put_memo(*key, blob, self.1);
        }
    }
}

/// Returns the nodes of a run; those of the pipeline that it has not made have what the last whole run made of them.
///
/// # Errors
/// A store that cannot be read.
fn nodes(session: &Session, record: &RunRecord) -> Result<Vec<NodeView>, Error> {
    let mut views = nodes_of(session, record);
    if session.is_whole(record) {
        return Ok(views);
    }
    let whole = session.earlier(record, |run| session.is_whole(run))?;
    for earlier in whole.iter().flat_map(|run| nodes_of(session, run)) {
        let earlier = NodeView {
            of_run: whole.as_ref().map(|run| run.number),
            ..earlier
        };
        match views.iter_mut().find(|view| view.name == earlier.name) {
            Some(view) if view.state.is_good() => {}
            Some(view) => view.show(earlier),
            None => views.push(NodeView {
                state: State::Skipped,
                reason: "not part of this run".to_owned(),
                ..earlier
            }),
        }
    }
    Ok(views)
}

/// Returns the nodes of a run, without children.
fn nodes_of(session: &Session, record: &RunRecord) -> Vec<NodeView> {
    let parents = record.nodes.iter().filter(|node| node.parent.is_none());
    let view = |node: &marf_engine::NodeRun| {
        let info = session.nodes.iter().find(|info| info.name == node.name);
        let children = record
            .nodes
            .iter()
            .filter(|child| child.parent.as_deref() == Some(node.name.as_str()));
        NodeView {
            name: node.name.clone(),
            stage: node.stage.clone(),
            about: info.map(|info| info.about.to_owned()).unwrap_or_default(),
            relax: info.and_then(|info| info.relax),
            upstream: node
                .edges
                .iter()
                .map(|edge| (edge.key.clone(), edge.upstream.clone()))
                .collect(),
            state: state(node.state),
            reason: node.reason.clone(),
            of_run: None,
            seconds: (node.state == NodeState::Finished).then_some(node.seconds),
            training_s: training_s(session, node),
            params: info.map(|info| info.params.clone()).unwrap_or_default(),
            outputs: node
                .outputs
                .iter()
                .map(|(name, output)| (name.clone(), output.digest))
                .collect(),
            children: children
                .map(|child| ChildView {
                    name: child.name.clone(),
                    state: state(child.state),
                    seconds: (child.state == NodeState::Finished).then_some(child.seconds),
                })
                .collect(),
        }
    };
    parents.map(view).collect()
}

/// Returns the seconds of a training's steps when it was made; none of other nodes.
fn training_s(session: &Session, node: &marf_engine::NodeRun) -> Option<f64> {
    let record = session.store.record(&node.key?).ok().flatten()?;
    record.metadata.parts_s.get("training").copied()
}

fn state(state: NodeState) -> State {
    match state {
        NodeState::Reused => State::Reused,
        NodeState::Finished => State::Ran,
        NodeState::Failed => State::Failed,
        NodeState::Skipped | NodeState::Cancelled => State::Skipped,
    }
}
