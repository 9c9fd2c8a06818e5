//! A run as it is handed out.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_engine::{Build, Outcome, RunRecord, document};

use crate::error::ExportError;

/// A run that is done, as plain data.
#[derive(Debug, Clone)]
pub struct Run {
    /// The bytes of its root.
    pub root: Vec<u8>,
    /// Its name, unique in its store.
    pub id: String,
    /// Name of the pipeline.
    pub pipeline: String,
    /// The command as typed.
    pub command: String,
    /// The program with version and commit.
    pub program: String,
    /// Start, in seconds since 1970.
    pub started_unix_s: u64,
    /// Wall time.
    pub seconds: f64,
    /// The program's file; none in older roots.
    pub build: Option<Build>,
    /// Objects that belong to the run as a whole, by the name of their file.
    pub documents: BTreeMap<String, Digest>,
    /// Nodes in topological order, the children of an expanded node after it.
    pub nodes: Vec<Node>,
}

/// A node of a run and its result.
#[derive(Debug, Clone)]
pub struct Node {
    /// Its name; of a child `parent/child`.
    pub name: String,
    /// The node whose child it is.
    pub parent: Option<String>,
    /// The nodes whose outputs it was given.
    pub upstream: Vec<String>,
    /// Key of the result: the digest of its action.
    pub key: Digest,
    /// What it made, by name.
    pub outputs: BTreeMap<String, NodeOutput>,
    /// Lists of the files that it read of an archive and where they came from; empty if it read none.
    pub origins: Vec<Digest>,
    /// Objects that its outputs name and that are no outputs (photos made of others).
    pub needs: Vec<Digest>,
    /// When the work began that made the result, in this run or an earlier one, in seconds since 1970; none in older roots.
    pub started_unix_s: Option<u64>,
    /// Wall time of that work.
    pub seconds: f64,
    /// Program and device that made the result, for people; none if nobody knows.
    pub made_by: Option<String>,
}

/// An output of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeOutput {
    /// Digest of its bytes.
    pub digest: Digest,
    /// The name of the file that it is elsewhere; none for sets, which are many files.
    pub file: Option<String>,
}

impl Run {
    /// Reads a run root. The names of files and how results were made are not in it.
    ///
    /// # Errors
    /// Bytes that are no root, one of a newer form, or a run in which a node has no result.
    pub fn of(root: Vec<u8>) -> Result<Self, ExportError> {
        let record: RunRecord =
            serde_json::from_slice(&root).map_err(|error| ExportError::BadRoot(error.to_string()))?;
        if record.format > marf_engine::RUN_FORMAT {
            let (found, known) = (record.format, marf_engine::RUN_FORMAT);
            return Err(ExportError::BadRoot(format!(
                "it has form {found}, this program reads up to {known}"
            )));
        }
        let unfinished = |outcome: String| ExportError::Unfinished {
            id: record.id.clone(),
            outcome,
        };
        if record.outcome != Outcome::Done {
            return Err(unfinished(format!("{:?}", record.outcome).to_lowercase()));
        }
        let node = |node: &marf_engine::NodeRun| {
            let key = node.key.filter(|_| node.state.is_good());
            let outputs = node.outputs.iter().map(|(name, output)| {
                let (digest, file) = (output.digest, None);
                (name.clone(), NodeOutput { digest, file })
            });
            Ok(Node {
                name: node.name.clone(),
                parent: node.parent.clone(),
                upstream: node.edges.iter().map(|edge| edge.upstream.clone()).collect(),
                key: key.ok_or_else(|| unfinished(format!("`{}` has none", node.name)))?,
                outputs: outputs.collect(),
                origins: Vec::new(),
                needs: Vec::new(),
                started_unix_s: node.started_unix_s,
                seconds: node.seconds,
                made_by: None,
            })
        };
        let nodes: Result<Vec<Node>, ExportError> = record.nodes.iter().map(node).collect();
        Ok(Self {
            nodes: nodes?,
            id: record.id,
            pipeline: record.pipeline,
            command: record.command,
            program: record.program,
            started_unix_s: record.started_unix_s,
            seconds: record.seconds,
            build: record.build,
            documents: record
                .documents
                .into_iter()
                .map(|(name, output)| (name, output.digest))
                .collect(),
            root,
        })
    }

    /// Returns the pipeline as it was written; none in older roots.
    pub fn written(&self) -> Option<Digest> {
        self.documents.get(document::WRITTEN).copied()
    }

    /// Returns the node of this name.
    ///
    /// # Errors
    /// A run without it.
    pub fn node(&self, name: &str) -> Result<&Node, ExportError> {
        let node = self.nodes.iter().find(|node| node.name == name);
        node.ok_or_else(|| ExportError::UnknownNode {
            node: name.to_owned(),
        })
    }
}
