//! Run records: the state of each node in a run, stored under `.marf/runs`.

use std::collections::BTreeMap;

use marf_cache::{Digest, Output, SetError, Store, StoreError};
use serde::{Deserialize, Serialize};

use crate::{check::Edge, graph::Graph, source::RunSource};

/// A run and its results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Number of the run in its store, from 1. It is not in the file, as it is the file's name. 0 if the run is not stored.
    #[serde(skip)]
    pub number: u64,
    /// Digest of the run root's bytes, which is in the file's name. Absent if the run is not stored.
    #[serde(skip)]
    pub root: Option<Digest>,
    /// [`RUN_FORMAT`].
    pub format: u32,
    /// Name of the run, unique in its store: it is in all events.
    pub id: String,
    /// Name of the pipeline.
    pub pipeline: String,
    /// Its source: a pipeline, a folder, or another run.
    pub source: RunSource,
    /// The command as typed.
    pub command: String,
    /// The program with its version.
    pub program: String,
    /// The program's file. Absent if it cannot be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub build: Option<Build>,
    /// Start, in seconds since 1970.
    pub started_unix_s: u64,
    /// Wall time.
    pub seconds: f64,
    /// How it ended.
    pub outcome: Outcome,
    /// Digest of the pipeline as declared.
    pub digest: Digest,
    /// Threads it could use.
    pub threads: usize,
    /// Nodes in topological order, the children of an expanded node after it.
    pub nodes: Vec<NodeRun>,
    /// Objects that belong to the run as a whole, by name ([`document`]).
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub documents: BTreeMap<String, Output>,
    /// The last key under which each node finished, in this run or an earlier one of this pipeline.
    pub latest: BTreeMap<String, Digest>,
}

/// Version of the form of run records. Records of another form are refused.
pub const RUN_FORMAT: u32 = 4;

/// Names of the documents of a run ([`RunRecord::documents`]).
pub mod document {
    /// The pipeline as written.
    pub const WRITTEN: &str = "pipeline.toml";
    /// The pipeline as it ran, with all overrides and the device of each node, as JSON.
    pub const RESOLVED: &str = "pipeline.json";
    /// The report.
    pub const REPORT: &str = "report.html";
    /// The verdicts on all photos as a table.
    pub const VERDICTS: &str = "verdicts.csv";
    /// The metrics of the trainings of `marf fit`, by time.
    pub const METRICS: &str = "metrics.json";
    /// The figures of `marf trade`.
    pub const TRADE: &str = "trade.json";
}

/// A program's file: which program ran, to the byte. It names no folder and no host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    /// Commit of the sources, with `+changes` appended if files differed from it. Absent if it was not built in a repository.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
    /// Digest of the file.
    pub blake3: Digest,
    /// Its length.
    pub bytes: u64,
    /// Operating system (`linux`).
    pub os: String,
    /// Processor (`x86_64`).
    pub arch: String,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Every node has its result.
    Done,
    /// At least one node failed.
    Failed,
    /// The run was cancelled.
    Cancelled,
}

/// The run of one node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeRun {
    /// Name of the node. A child is named `parent/child`.
    pub name: String,
    /// Name of its stage.
    pub stage: String,
    /// The node whose child it is.
    pub parent: Option<String>,
    /// The upstream nodes of its inputs.
    pub edges: Vec<Edge>,
    /// Its inputs by name. Empty if the run stopped before they were known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub inputs: BTreeMap<String, NodeInput>,
    /// Its key, if its inputs were known.
    pub key: Option<Digest>,
    /// What happened.
    pub state: NodeState,
    /// Why.
    pub reason: String,
    /// The cause of a failure, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
    /// What to do about a failure, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hint: Option<String>,
    /// Wall time. For a reused node, this is the time of the run that made the result.
    pub seconds: f64,
    /// Start of the work that made the result, in seconds since 1970. Absent without a result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started_unix_s: Option<u64>,
    /// Output blobs by name.
    pub outputs: BTreeMap<String, Output>,
    /// Figures, as in [`crate::Event::Finished`].
    pub counts: BTreeMap<String, u64>,
}

/// An input of a node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeInput {
    /// Digest of the content.
    pub digest: Digest,
    /// The output that it is. Absent if no node of the run made it (a listing of an archive, the node's own earlier output).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub made_by: Option<OutputName>,
}

/// An output of a node.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct OutputName {
    /// Name of the node.
    pub node: String,
    /// Name of the output.
    pub output: String,
}

/// What happened to a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeState {
    /// Its result was in the store.
    Reused,
    /// It ran.
    Finished,
    /// It failed.
    Failed,
    /// An upstream node has no result.
    Skipped,
    /// The run was stopped before its end.
    Cancelled,
}

/// Why bytes are not a run record of this program.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// They are of another form.
    #[error("it has form {found}, and this marf reads only form {RUN_FORMAT}")]
    Form {
        /// Their form, or 0 if they name none.
        found: u32,
    },
    /// They cannot be parsed.
    #[error(transparent)]
    Malformed(#[from] serde_json::Error),
}

/// Why a plan or a run cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A name that is not in the graph.
    #[error("there is no node `{node}`. The nodes are {}", known.join(", "))]
    UnknownNode {
        /// The name.
        node: String,
        /// The names of all nodes.
        known: Vec<String>,
    },
    /// The threads of a run cannot be started.
    #[error("{threads} threads cannot be started: {message}")]
    Threads {
        /// Their number.
        threads: usize,
        /// The error of the operating system.
        message: String,
    },
    /// The user wants to stop.
    #[error("stopped")]
    Stopped,
    /// A set of photos that cannot be read.
    #[error("a set of photos cannot be read: {0}")]
    BadSet(String),
    /// A run record that cannot be read.
    #[error("run {number} cannot be read: {message}")]
    BadRun {
        /// Its number.
        number: u64,
        /// The error of the reader.
        message: String,
    },
}

impl From<SetError> for EngineError {
    fn from(error: SetError) -> Self {
        match error {
            SetError::Store(error) => Self::Store(error),
            SetError::Manifest(error) => Self::BadSet(error.to_string()),
        }
    }
}

impl EngineError {
    /// Returns the error of a name that is not in a graph.
    pub(crate) fn unknown(graph: &Graph, node: &str) -> Self {
        Self::UnknownNode {
            node: node.to_owned(),
            known: graph.names().into_iter().map(str::to_owned).collect(),
        }
    }

    /// Returns a hint for the user, if there is one.
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Store(error) => error.hint(),
            _ => None,
        }
    }
}

impl NodeState {
    /// Returns whether the node has its outputs.
    pub fn is_good(self) -> bool {
        matches!(self, Self::Reused | Self::Finished)
    }
}

impl RunRecord {
    /// Reads the bytes of a run root. They do not contain its number.
    ///
    /// # Errors
    /// Bytes that are not a record, or a record of another form.
    pub fn decode(root: &[u8]) -> Result<Self, RecordError> {
        #[derive(Deserialize)]
        struct Form {
            #[serde(default)]
            format: u32,
        }
        let Form { format: found } = serde_json::from_slice(root)?;
        if found != RUN_FORMAT {
            return Err(RecordError::Form { found });
        }
        Ok(Self {
            root: Some(Digest::from_content(root)),
            ..serde_json::from_slice(root)?
        })
    }

    /// Returns the objects that the run names: outputs of its nodes, and documents.
    pub fn objects(&self) -> impl Iterator<Item = Digest> {
        let outputs = self.nodes.iter().flat_map(|node| node.outputs.values());
        outputs.chain(self.documents.values()).map(|output| output.digest)
    }

    /// Stores the record under the next free number. If nothing ran, a read-only store only causes a warning, and the run has no number.
    ///
    /// # Errors
    /// A store that cannot be written.
    pub fn store(self, store: &Store, warn: impl Fn(String)) -> Result<Self, EngineError> {
        let json = serde_json::to_vec_pretty(&self).map_err(|error| EngineError::BadRun {
            number: 0,
            message: error.to_string(),
        })?;
        match store.put_run(&json) {
            Ok(number) => Ok(Self {
                number,
                root: Some(Digest::from_content(&json)),
                ..self
            }),
            Err(error) if error.is_read_only() && !self.has_run() => {
                warn(format!("this run is not recorded: {error}"));
                Ok(self)
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Returns whether the run goes on: the record says how far it is ([`crate::StateListener::on_state`]).
    pub fn goes_on(&self) -> bool {
        self.outcome == Outcome::Cancelled && self.number == 0
    }

    fn has_run(&self) -> bool {
        self.nodes.iter().any(|node| node.state == NodeState::Finished)
    }

    /// Returns whether two runs have the same nodes with the same keys, so that nothing differs between them.
    pub fn has_keys_of(&self, other: &Self) -> bool {
        let keys = |run: &Self| -> BTreeMap<String, Option<Digest>> {
            run.nodes
                .iter()
                .map(|node| (node.name.clone(), node.key))
                .collect()
        };
        keys(self) == keys(other)
    }

    /// Returns the run of a node.
    pub fn node(&self, name: &str) -> Option<&NodeRun> {
        self.nodes.iter().find(|node| node.name == name)
    }
}

/// Reads all runs, oldest first. A run that cannot be read is left out and warned of.
///
/// # Errors
/// A folder that cannot be read.
pub fn runs(store: &Store, warn: impl Fn(String)) -> Result<Vec<RunRecord>, EngineError> {
    let numbers = store.run_numbers()?.into_iter();
    Ok(numbers.filter_map(|number| read(store, number, &warn)).collect())
}

/// Reads the run with which a run is compared, and which has its earlier outputs. It is the last run of the same pipeline and source, or
/// for a derived run its base. A run that cannot be read is skipped with a warning.
///
/// # Errors
/// A folder that cannot be read.
pub fn last_run(
    store: &Store,
    pipeline: &str,
    source: &RunSource,
    warn: impl Fn(String),
) -> Result<Option<RunRecord>, EngineError> {
    let RunSource::Derived { from, .. } = source else {
        return last_run_where(store, warn, |run| {
            run.pipeline == pipeline && run.source == *source
        });
    };
    match from {
        None => Ok(None),
        Some(from) => last_run_where(store, warn, |run| run.root == Some(*from)),
    }
}

/// Reads the last run that is `wanted`. A newer run that cannot be read is left out and warned of.
///
/// # Errors
/// A folder that cannot be read.
pub fn last_run_where(
    store: &Store,
    warn: impl Fn(String),
    wanted: impl Fn(&RunRecord) -> bool,
) -> Result<Option<RunRecord>, EngineError> {
    let numbers = store.run_numbers()?.into_iter().rev();
    let mut runs = numbers.filter_map(|number| read(store, number, &warn));
    Ok(runs.find(wanted))
}

/// Reads a run by its number.
///
/// # Errors
/// [`EngineError::BadRun`]: a run that is not there, damaged, or of another form.
pub fn run_of(store: &Store, number: u64) -> Result<RunRecord, EngineError> {
    let bad = |message: String| EngineError::BadRun { number, message };
    let bytes = store.run(number).map_err(|error| bad(error.to_string()))?;
    let run = RunRecord::decode(&bytes).map_err(|error| bad(error.to_string()))?;
    Ok(RunRecord { number, ..run })
}

/// Reads one run. None if it cannot be read.
fn read(store: &Store, number: u64, warn: &impl Fn(String)) -> Option<RunRecord> {
    match run_of(store, number) {
        Ok(run) => Some(run),
        Err(error) => {
            warn(format!("{error}. This run is skipped"));
            None
        }
    }
}
