use std::collections::BTreeMap;
use std::sync::Arc;

use marf_cache::Digest;

use super::trade::Trade;

/// Looks up the bytes of a digest; `None` where the store does not have them.
pub type ReadBlob<'a> = dyn Fn(&Digest) -> Option<Arc<[u8]>> + 'a;

/// What a report is made of.
pub struct ReportInput<'a> {
    /// Name of the pipeline.
    pub pipeline: String,
    /// The command line that ran it.
    pub command: String,
    /// When the run started, RFC 3339; only shown.
    pub started: String,
    /// Name and version of the program.
    pub program: String,
    /// The nodes, in any order; producers before consumers reads best.
    pub nodes: Vec<NodeView>,
    /// Of the page of a scene, the page of all scenes, from where this one is; nodes that all share are on that.
    pub whole: Option<String>,
    /// The scenes that the photos are split into, each with its nodes, which are not among `nodes`.
    pub scenes: Vec<SceneView>,
    /// What changed since the last run that had other results; absent if there was none.
    pub changes: Option<Changes>,
    /// The last trade of time against quality that was measured around the pipeline.
    pub trade: Option<Trade>,
    /// The store.
    pub read: &'a ReadBlob<'a>,
    /// Where pictures as they are embedded are kept from report to report.
    pub memos: &'a dyn marf_stage::Memos,
}

/// A scene of a pipeline whose photos are split by place.
#[derive(Debug, Clone)]
pub struct SceneView {
    /// Its name.
    pub name: String,
    /// Its page, from where this one is.
    pub page: String,
    /// Its nodes.
    pub nodes: Vec<NodeView>,
}

/// What changed since an earlier run.
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

/// A node of the pipeline as the run left it.
#[derive(Debug, Clone)]
pub struct NodeView {
    /// Name in pipeline.toml.
    pub name: String,
    /// Name of its stage.
    pub stage: String,
    /// One line about the stage.
    pub about: String,
    /// Of a filter: what in its table keeps photos that it rejects.
    pub relax: Option<&'static str>,
    /// (Key of the port, name of the upstream node).
    pub upstream: Vec<(String, String)>,
    /// Its state.
    pub state: State,
    /// The earlier run that its outputs are of; none: this one.
    pub of_run: Option<u64>,
    /// Why it ran, was reused or skipped; of a failed node the message.
    pub reason: String,
    /// Wall time of its work, seconds; of a reused node what it took then, if known.
    pub seconds: Option<f64>,
    /// Seconds of its steps alone, where it has trained.
    pub training_s: Option<f64>,
    /// Its parameters.
    pub params: serde_json::Value,
    /// Its outputs by name.
    pub outputs: BTreeMap<String, Digest>,
    /// Its child nodes.
    pub children: Vec<ChildView>,
}

impl NodeView {
    /// Shows what another run made of this node; how it fared in this run stays.
    pub fn show(&mut self, other: Self) {
        *self = Self {
            state: self.state,
            reason: std::mem::take(&mut self.reason),
            ..other
        };
    }
}

/// A child node: a tuning trial, a retraining.
#[derive(Debug, Clone)]
pub struct ChildView {
    /// Its name below the parent.
    pub name: String,
    /// Its state.
    pub state: State,
    /// Wall time of its work, seconds.
    pub seconds: Option<f64>,
}

/// The state of a node in this run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Worked in this run.
    Ran,
    /// Its outputs were there already.
    Reused,
    /// Stopped with an error.
    Failed,
    /// Not run, since a node before it failed or it was not selected.
    Skipped,
}

impl State {
    /// Tells whether the node has its outputs.
    pub const fn is_good(self) -> bool {
        matches!(self, Self::Ran | Self::Reused)
    }

    /// The state as a word, also its class in the style sheet.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ran => "ran",
            Self::Reused => "reused",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
        }
    }
}
