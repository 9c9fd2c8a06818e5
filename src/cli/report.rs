use std::path::Path;
use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_engine::{Cancel, NodeState, RunRecord, document};
use marf_export::iso_time;
use marf_provenance::lineage::Lineage;
use marf_stage::Memos;

use super::args::Global;
use super::documents::{self, Documents};
use super::error::CliError;
use super::session::{Session, TRADES, warn};
use super::{diff, export, files};
use crate::show::trade::Trade;
use crate::show::{self, ChangedNode, Changes, ChildView, NodeView, ReportInput, State};
use crate::terminal::eprint_line;

/// `marf report`: writes the report of the last run: the one that the run kept, or for a run without one a new one.
pub fn report(global: &Global, out: &Path, cancel: &Cancel) -> Result<(), CliError> {
    let session = Session::open(global, cancel)?;
    let record = session
        .last()?
        .ok_or_else(|| CliError::failed(format!("`{}` has not run yet", session.name)))?;
    let kept = record.documents.get(document::REPORT);
    match kept.filter(|kept| session.store.contains(&kept.digest)) {
        Some(kept) => export::one(&session, &record, &kept.digest, out)?,
        None => files::write(out, page(&session, &record)?.as_bytes())?,
    }
    eprint_line(&format!("wrote {}", out.display()));
    Ok(())
}

/// Stores the report of a run; that of the last run stays where nothing ran.
///
/// # Errors
/// A store that cannot be read or written.
pub fn document(session: &Session, record: &RunRecord) -> Result<Documents, CliError> {
    let report = match documents::unchanged(session, record, document::REPORT)? {
        Some(kept) => (document::REPORT.to_owned(), kept),
        None => documents::put(session, document::REPORT, page(session, record)?.as_bytes())?,
    };
    Ok(Documents::from([report]))
}

/// Returns the report of a run.
///
/// # Errors
/// A store that cannot be read or written, the wish to stop.
pub fn page(session: &Session, record: &RunRecord) -> Result<String, CliError> {
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
        .unwrap_or_else(|| Digest::of(&[]));
    let input = ReportInput {
        pipeline: record.pipeline.clone(),
        command: record.command.clone(),
        started: iso_time(record.started_unix_s),
        program: record.program.clone(),
        nodes: nodes(session, record)?,
        changes: changes(session, record)?,
        trade: trade(session, record)?,
        read: &read,
        memos: &StoreMemos(&session.store, maker),
    };
    let page = show::write(&input);
    session.check()?;
    session.store.commit()?;
    Ok(page)
}

/// Returns what changed since the last run of the pipeline with other results, so that a run that does nothing has what the one
/// before it has; children of nodes are left out.
///
/// # Errors
/// A store that cannot be read, the wish to stop.
fn changes(session: &Session, record: &RunRecord) -> Result<Option<Changes>, CliError> {
    session.check()?;
    let Some(before) = session.before(record)? else {
        return Ok(None);
    };
    let since = before.number;
    let parents = |run: RunRecord| -> Result<_, CliError> {
        let mut lineage = Lineage::of(&session.store, run)?;
        lineage.nodes.retain(|node| !node.is_child());
        Ok(lineage)
    };
    let nodes = diff::compare(&parents(before)?, &parents(record.clone())?, diff::MOST)?;
    let runs = [&*format!("run {since}"), "this run"];
    let changed = |node: &diff::NodeChanges| ChangedNode {
        heading: node.heading(runs),
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
fn trade(session: &Session, record: &RunRecord) -> Result<Option<Trade>, CliError> {
    let name = format!("{}{TRADES}", record.pipeline.trim_end_matches(TRADES));
    let has_trade = |run: &RunRecord| run.documents.contains_key(document::TRADE);
    let run = marf_engine::last_run_where(&session.store, &name, warn, has_trade)?;
    let kept = run.and_then(|run| run.documents.get(document::TRADE).copied());
    let bytes = kept.map(|kept| session.store.get(&kept.digest)).transpose()?;
    let read = |bytes: Arc<[u8]>| serde_json::from_slice(&bytes);
    let trade = bytes.map(read).transpose();
    trade.map_err(|error| CliError::failed(format!("{}: {error}", document::TRADE)))
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
fn nodes(session: &Session, record: &RunRecord) -> Result<Vec<NodeView>, CliError> {
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

fn state(state: NodeState) -> State {
    match state {
        NodeState::Reused => State::Reused,
        NodeState::Finished => State::Ran,
        NodeState::Failed => State::Failed,
        NodeState::Skipped | NodeState::Cancelled => State::Skipped,
    }
}
