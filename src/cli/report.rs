use std::path::Path;
use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_engine::{Cancel, NodeState, RunRecord};
use marf_stage::Memos;

use super::args::Global;
use super::error::CliError;
use super::files;
use super::log::utc;
use super::session::Session;
use crate::show::{self, ChildView, NodeView, ReportInput, State};
use crate::terminal::eprint_line;

/// `marf report`: writes the report of the last run.
pub fn report(global: &Global, out: &Path, cancel: &Cancel) -> Result<(), CliError> {
    let session = Session::open(global, cancel)?;
    let record = session
        .last()?
        .ok_or_else(|| CliError::failed(format!("`{}` has not run yet", session.name)))?;
    write(&session, &record, out)?;
    eprint_line(&format!("wrote {}", out.display()));
    Ok(())
}

/// Writes the report after a run, unless nothing ran and the report that is there is of the same keys.
///
/// # Errors
/// A place that cannot be written.
pub fn refresh(session: &Session, record: &RunRecord, out: &Path) -> Result<(), CliError> {
    let nothing_ran = record.nodes.iter().all(|node| node.state == NodeState::Reused);
    let current = std::fs::read_to_string(out).is_ok_and(|text| text.contains(&marker(record)));
    if nothing_ran && current {
        Ok(())
    } else {
        write(session, record, out)
    }
}

/// Writes the report of a run.
///
/// # Errors
/// A place that cannot be written.
pub fn write(session: &Session, record: &RunRecord, out: &Path) -> Result<(), CliError> {
    let read = |digest: &Digest| -> Option<Arc<[u8]>> { session.store.get(digest).ok() };
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
        started: utc(record.started_unix_s),
        program: record.program.clone(),
        nodes: nodes(session, record),
        read: &read,
        memos: &StoreMemos(&session.store, maker),
    };
    let page = show::write(&input);
    session.store.commit()?;
    files::write(out, format!("{page}\n{}\n", marker(record)).as_bytes())
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

/// Returns a comment with a digest of the keys of all nodes: equal keys give equal reports.
fn marker(record: &RunRecord) -> String {
    let keys: Vec<String> = record
        .nodes
        .iter()
        .map(|node| node.key.map(|key| key.to_string()).unwrap_or_default())
        .collect();
    format!("<!-- keys {} -->", Digest::of(keys.join(" ").as_bytes()))
}

fn nodes(session: &Session, record: &RunRecord) -> Vec<NodeView> {
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
            upstream: node
                .edges
                .iter()
                .map(|edge| (edge.key.clone(), edge.upstream.clone()))
                .collect(),
            state: state(node.state),
            reason: node.reason.clone(),
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
