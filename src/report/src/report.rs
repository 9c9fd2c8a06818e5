use std::collections::BTreeMap;
use std::sync::Arc;

use marf_cache::Digest;
use marf_engine::NodeState;
use marf_model::{Run, RunNode};
use marf_stage::StageDef;
use serde_json::Value;

use super::trade::Trade;

/// Looks up the bytes of a digest. `None` if the store does not have them.
pub type ReadBlob<'a> = dyn Fn(&Digest) -> Option<Arc<[u8]>> + 'a;

/// Input of a report.
pub struct Report<'a> {
    /// The run, with what an earlier one made of nodes that it has no result of.
    pub run: &'a Run<'a>,
    /// When it started, RFC 3339. Only shown.
    pub started: String,
    /// The scene of this page. `None`: the page of everything that the scenes share.
    pub scene: Option<&'a str>,
    /// The nodes of the page, without the children of other nodes. Producers before consumers reads best.
    pub nodes: Vec<&'a RunNode>,
    /// The scenes that the photos are split into, each with its nodes, which are not among `nodes`.
    pub scenes: Vec<ScenePage<'a>>,
    /// Parameters of the nodes by name, as given.
    pub params: &'a BTreeMap<String, Value>,
    /// Changes since the last run with other results. Absent if there was none.
    pub changes: Option<Changes>,
    /// The last trade of time against quality that was measured around the pipeline.
    pub trade: Option<Trade>,
    /// The store.
    pub read: &'a ReadBlob<'a>,
    /// Memory of scaled pictures, kept from report to report.
    pub memos: &'a dyn marf_stage::Memos,
}

impl Report<'_> {
    /// Returns the name of the pipeline, and of the scene.
    pub(super) fn title(&self) -> String {
        let pipeline = &self.run.record.pipeline;
        self.scene
            .map_or_else(|| pipeline.clone(), |scene| format!("{pipeline}, {scene}"))
    }

    /// Returns a node of the page.
    pub(super) fn node(&self, name: &str) -> Option<&RunNode> {
        self.nodes.iter().find(|node| node.run.name == name).copied()
    }

    /// Returns the names of the nodes that a node reads. On the page of all scenes a node of a scene is replaced by those that this
    /// reads, which are on the same page.
    pub(super) fn upstream<'r>(&'r self, node: &'r RunNode) -> Vec<&'r str> {
        if self.scene.is_some() {
            return node.upstream().collect();
        }
        let mut upstream = Vec::new();
        let mut open: Vec<&str> = node.upstream().collect();
        open.reverse();
        while let Some(name) = open.pop() {
            let of_scene = self.run.node(name).filter(|_| self.node(name).is_none());
            match of_scene {
                Some(node) => {
                    let first = open.len();
                    open.extend(node.upstream());
                    open[first..].reverse();
                }
                None if !upstream.contains(&name) => upstream.push(name),
                None => {}
            }
        }
        upstream
    }
}

/// A scene of a pipeline whose photos are split by place.
#[derive(Debug, Clone)]
pub struct ScenePage<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its page, from where the report is.
    pub page: String,
    /// Its nodes.
    pub nodes: Vec<&'a RunNode>,
}

/// Changes since an earlier run.
#[derive(Debug, Clone)]
pub struct Changes {
    /// Number of that run.
    pub since: u64,
    /// The nodes that differ.
    pub nodes: Vec<ChangedNode>,
}

/// A node that differs from that of an earlier run.
#[derive(Debug, Clone)]
pub struct ChangedNode {
    /// Its name and how much differs.
    pub heading: String,
    /// Parameters, products, values and pictures that differ.
    pub lines: Vec<String>,
}

/// The words for the state of a node, which are also its classes in the style sheet.
pub(super) const STATES: [&str; 5] = ["ran", "reused", FAILED, SKIPPED, WAITING];
pub(super) const FAILED: &str = "failed";
pub(super) const SKIPPED: &str = "skipped";
/// The run goes on, or was stopped before the node had its result.
pub(super) const WAITING: &str = "waiting";

/// Returns the word for the state of a node.
pub(super) const fn state(node: &RunNode) -> &'static str {
    match node.run.state {
        NodeState::Finished => "ran",
        NodeState::Reused => "reused",
        NodeState::Failed => FAILED,
        NodeState::Skipped => SKIPPED,
        NodeState::Cancelled => WAITING,
    }
}

/// Returns how nodes fared together: as the one that fared worst, and `ran` where any ran.
pub(super) fn state_of_all(nodes: &[&RunNode]) -> Option<&'static str> {
    let mut worst_first = [FAILED, SKIPPED, WAITING, "ran", "reused"].into_iter();
    worst_first.find(|word| nodes.iter().any(|node| state(node) == *word))
}

/// Returns the row of the table of stages for a node.
pub(super) fn stage(node: &RunNode) -> Option<&'static StageDef> {
    marf_stages::stages()
        .iter()
        .find(|def| def.name == node.run.stage)
}
