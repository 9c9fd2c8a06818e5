//! The report of a run, and the pages of its scenes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_config::scenes::scene_of;
use marf_engine::{Outcome, Purpose, RunRecord, document};
use marf_export::iso_time;
use marf_model::{Run, RunNode, select};
use marf_report::trade::Trade;
use marf_report::{ChangedNode, Changes, EmbeddedView, LinkedPage, LiveParts, Report, ScenePage};
use serde_json::Value;

use crate::context::Context;
use crate::diff;
use crate::documents::{self, Documents};
use crate::error::Error;
use crate::report_memos::StoreMemos;
use crate::session::Session;
use crate::{files, outputs, scenes};

/// Writes the report of a run: of the given number, or else of the last run. That is the stored one, or a new one if the last run stored
/// none. Without a pipeline file, writes the report of the newest verb on a folder that keeps one.
///
/// # Errors
/// A pipeline that has not run, a store that cannot be read, a place that cannot be written.
pub fn report(context: &Context, out: &Path, number: Option<u64>) -> Result<(), Error> {
    if number.is_some() || !context.file.is_file() {
        return outputs::report(context, out, number);
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

/// Stores the report of a run, and a page for each of its scenes. Pages of the last run are kept if none of their nodes ran.
///
/// # Errors
/// A store that cannot be read or written.
pub fn documents(session: &Session, record: &RunRecord) -> Result<Documents, Error> {
    let all = session.scenes.iter().map(|scene| Some(scene.as_str()));
    let page = |scene: Option<&str>| {
        let name = scene.map_or(document::REPORT.to_owned(), scenes::page_name);
        match documents::unchanged(session, record, &name, |node| is_on_page(node, scene))? {
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

/// Returns the report of a run: for one of its scenes, or for the nodes that all scenes share, with a list of the scenes. That of a run
/// that was stopped is made although the user wants to stop.
///
/// # Errors
/// As [`page`].
pub fn page_of(session: &Session, record: &RunRecord, scene: Option<&str>) -> Result<String, Error> {
    let is_stopped = record.outcome == Outcome::Cancelled && !record.goes_on();
    let check = || if is_stopped { Ok(()) } else { session.check() };
    check()?;
    let params = session
        .nodes
        .iter()
        .map(|node| (node.name.clone(), node.params.clone()));
    let params: BTreeMap<String, Value> = params.collect();
    let names: Vec<&String> = params.keys().collect();
    // Each rewrite would warn again.
    let warn = |message: String| {
        if !record.goes_on() {
            session.context.warn(message);
        }
    };
    let run = completed(&session.store, record, &session.tree, &names, warn)?;
    // After a cancellation nothing more is read, and no report is made of the objects read so far.
    let read = |digest: &Digest| -> Option<Arc<[u8]>> {
        check().ok()?;
        session.store.get(digest).ok()
    };
    // Pictures of the page are kept as long as the last result it shows.
    let maker = record.nodes.iter().rev().find_map(|node| node.key);
    let maker = maker.unwrap_or_else(|| Digest::from_content(&[]));
    let report = Report {
        changes: changes(&run, scene, &session.tree, warn)?,
        trade: trade(&run, scene, warn)?,
        read: &read,
        memos: &StoreMemos(&session.store, Some(maker)),
        run: &run,
        started: iso_time(record.started_unix_s),
        scene,
        nodes: nodes_of(&run, scene),
        scenes: pages(&run, scene, &session.scenes),
        params: &params,
    };
    let page = marf_report::write(&report);
    check()?;
    session.store.commit()?;
    Ok(page)
}

/// Writes the report of a stored run, or the page of one of its scenes, as served by the viewer.
///
/// # Errors
/// A store that cannot be read, or a scene that the run does not have.
pub fn linked(
    store: &Store,
    record: &RunRecord,
    scene: Option<&str>,
    live: &LiveParts,
) -> Result<LinkedPage, Error> {
    of_stored(store, record, scene, |report| marf_report::linked(report, live))
}

/// Returns the report of a stored run with a 3-D view, as one file.
///
/// # Errors
/// A store that cannot be read.
pub fn with_view(store: &Store, record: &RunRecord, view: &EmbeddedView) -> Result<String, Error> {
    of_stored(store, record, None, |report| {
        marf_report::write_with_view(report, view)
    })
}

/// Writes the report of a stored run, or the page of one of its scenes.
fn of_stored<T>(
    store: &Store,
    record: &RunRecord,
    scene: Option<&str>,
    write: impl FnOnce(&Report<'_>) -> T,
) -> Result<T, Error> {
    let resolved = documents::resolved(store, record).unwrap_or_default();
    let names: Vec<&String> = resolved["node"]
        .as_object()
        .into_iter()
        .flat_map(|nodes| nodes.keys())
        .collect();
    let run = completed(store, record, &resolved, &names, |_| {})?;
    let params = run.nodes.iter();
    let params =
        params.filter_map(|node| Some((node.run.name.clone(), node.action.as_ref()?.params.clone())));
    let names = run.nodes.iter().filter(|node| !node.is_child());
    let listed: BTreeSet<String> = names
        .filter_map(|node| scene_of(&node.run.name))
        .map(str::to_owned)
        .collect();
    if scene.is_some_and(|scene| !listed.contains(scene)) {
        return Err(Error::failed("the shown run has no such page"));
    }
    let report = Report {
        changes: changes(&run, scene, &resolved, |_| {})?,
        trade: trade(&run, scene, |_| {})?,
        read: &|digest| store.get(digest).ok(),
        memos: &StoreMemos(store, None),
        run: &run,
        started: iso_time(record.started_unix_s),
        scene,
        nodes: nodes_of(&run, scene),
        scenes: pages(&run, scene, &listed),
        params: &params.collect(),
    };
    Ok(write(&report))
}

/// Returns a run. Nodes of its pipeline without a result in it are taken from the last run on the same folders with results of all of
/// these. `resolved` is the pipeline of the run.
///
/// # Errors
/// A store that cannot be read.
fn completed<'s>(
    store: &'s Store,
    record: &RunRecord,
    resolved: &Value,
    names: &[&String],
    warn: impl Fn(String),
) -> Result<Run<'s>, Error> {
    let is_good = |run: &RunRecord, name: &str| run.node(name).is_some_and(|node| node.state.is_good());
    let is_whole = |run: &RunRecord| names.iter().all(|name| is_good(run, name));
    let run = Run::new(store, record.clone())?;
    if is_whole(record) {
        return Ok(run);
    }
    let is_wanted = |run: &RunRecord| is_whole(run) && is_on_folders_of(store, run, resolved);
    Ok(match select::earlier(store, record, warn, is_wanted)? {
        Some(whole) => run.completed(Run::new(store, whole)?),
        None => run,
    })
}

/// Returns the nodes of a scene, or those that all scenes share, without those that other nodes asked for.
fn nodes_of<'r>(run: &'r Run<'_>, scene: Option<&str>) -> Vec<&'r RunNode> {
    let nodes = run.nodes.iter();
    nodes
        .filter(|node| !node.is_child() && scene_of(&node.run.name) == scene)
        .collect()
}

/// Returns the pages of scenes that the report lists. The page of a scene lists none.
fn pages<'r>(
    run: &'r Run<'_>,
    scene: Option<&str>,
    scenes: impl IntoIterator<Item = &'r String>,
) -> Vec<ScenePage<'r>> {
    let listed = scenes.into_iter().filter(|_| scene.is_none());
    let page = |name: &'r String| ScenePage {
        name,
        page: scenes::page_name(name),
        nodes: nodes_of(run, Some(name)),
    };
    listed.map(page).collect()
}

/// Returns whether a page shows a node. The report shows all nodes, the page of a scene those of the scene.
fn is_on_page(node: &str, scene: Option<&str>) -> bool {
    scene.is_none() || scenes::is_of(node, scene)
}

/// Returns the folders that the archives of a resolved pipeline read, by archive.
fn folders(resolved: &Value) -> BTreeMap<&str, &Value> {
    let archives = resolved["archive"].as_object().into_iter().flatten();
    archives
        .filter_map(|(name, archive)| Some((name.as_str(), archive.get("path")?)))
        .collect()
}

/// Returns whether a run has read the same folders as a resolved pipeline.
fn is_on_folders_of(store: &Store, run: &RunRecord, resolved: &Value) -> bool {
    documents::resolved(store, run).is_ok_and(|of_run| folders(&of_run) == folders(resolved))
}

/// Returns the changes since the last run of the pipeline on the same folders with other results. So a run that computes nothing has the
/// changes of the one before it. Children of nodes are left out. `resolved` is the pipeline of the run.
///
/// # Errors
/// A store that cannot be read.
fn changes(
    run: &Run<'_>,
    scene: Option<&str>,
    resolved: &Value,
    warn: impl Fn(String),
) -> Result<Option<Changes>, Error> {
    let (store, record) = (run.store(), &run.record);
    let before = select::earlier(store, record, warn, |before| {
        before.outcome == Outcome::Done
            && !before.has_keys_of(record)
            && is_on_folders_of(store, before, resolved)
    })?;
    let Some(before) = before else {
        return Ok(None);
    };
    let since = before.number;
    let shown = |run: RunRecord| -> Result<_, Error> {
        let mut run = Run::new(store, run)?;
        run.nodes
            .retain(|node| !node.is_child() && is_on_page(&node.run.name, scene));
        Ok(run)
    };
    let nodes = diff::compare(&shown(before)?, &shown(record.clone())?, diff::MOST)?;
    let earlier = format!("run {since}");
    let changed = |node: &diff::NodeChanges| ChangedNode {
        heading: node.heading(&earlier, "this run"),
        lines: node.lines(),
    };
    Ok(Some(Changes {
        since,
        nodes: nodes.iter().map(changed).collect(),
    }))
}

/// Returns the last trade that was measured around the pipeline of a run. None on the page of a scene.
///
/// # Errors
/// A store that cannot be read.
fn trade(run: &Run<'_>, scene: Option<&str>, warn: impl Fn(String)) -> Result<Option<Trade>, Error> {
    if scene.is_some() {
        return Ok(None);
    }
    let store = run.store();
    let run = select::newest_derived(store, &run.record, Purpose::Trade, warn, |run| {
        run.documents.contains_key(document::TRADE)
    })?;
    let kept = run.and_then(|run| run.documents.get(document::TRADE).copied());
    let bytes = kept.map(|kept| store.get(&kept.digest)).transpose()?;
    let trade = bytes.map(|bytes| serde_json::from_slice(&bytes)).transpose();
    trade.map_err(|error| Error::failed(format!("{}: {error}", document::TRADE)))
}
