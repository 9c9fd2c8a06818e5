//! Lookup tables for the parts of the graph.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Action, Digest};
use marf_engine::{RunRecord, document};
use marf_model::{Run, RunNode};

use super::input::GraphInput;
use super::tools::Tools;

/// Lookup tables for the parts of the graph.
pub(super) struct Context<'a> {
    pub(super) input: &'a GraphInput<'a>,
    pub(super) ids: BTreeMap<Digest, &'a str>,
    pub(super) by_path: BTreeMap<&'a str, &'a str>,
    pub(super) tools: Tools,
    /// Nodes whose outputs no other node was given.
    pub(super) terminal: BTreeSet<&'a str>,
}

impl<'a> Context<'a> {
    pub(super) fn new(input: &'a GraphInput<'a>) -> Self {
        let files = input.files.iter();
        Self {
            input,
            ids: files
                .clone()
                .map(|described| (described.digest.blake3, described.id.as_str()))
                .collect(),
            by_path: files
                .map(|described| (described.file.path.as_str(), described.id.as_str()))
                .collect(),
            tools: Tools::new(input),
            terminal: terminal(input),
        }
    }

    pub(super) fn run(&self) -> &'a Run<'a> {
        self.input.run
    }

    pub(super) fn record(&self) -> &'a RunRecord {
        &self.input.run.record
    }

    /// Returns the id of the file that describes the pipeline: as it was written, or the run root of a run
    /// that kept no text.
    pub(super) fn pipeline(&self) -> &'a str {
        let written = self.record().documents.get(document::WRITTEN);
        let written = written.and_then(|output| self.ids.get(&output.digest));
        let root = || self.by_path.get(crate::contents::RUN_ROOT);
        written
            .or_else(root)
            .copied()
            .unwrap_or(crate::contents::RUN_ROOT)
    }

    pub(super) fn action(&self, node: &RunNode) -> Option<&'a Action> {
        self.input.contents.action(node)
    }

    pub(super) fn origins(&self, node: &RunNode) -> &'a [Digest] {
        self.input.contents.origins(node)
    }
}

/// Returns the nodes without a parent that no other such node is given the outputs of. What counts is who was connected to whom, not
/// who read the same bytes: a training passes its scene on, which other trainings read of `calibrate`.
fn terminal<'a>(input: &GraphInput<'a>) -> BTreeSet<&'a str> {
    let nodes = || {
        let nodes = input.run.record.nodes.iter();
        nodes.filter(|node| node.parent.is_none())
    };
    let given: BTreeSet<&str> = nodes()
        .flat_map(|node| node.edges.iter().map(|edge| edge.upstream.as_str()))
        .collect();
    let names = nodes().map(|node| node.name.as_str());
    names.filter(|name| !given.contains(name)).collect()
}
