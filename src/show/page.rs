use std::collections::BTreeMap;
use std::sync::Arc;

use marf_stage::{Document, VERDICTS, Verdict};
use maud::{Markup, html};

use super::embed::Pictures;
use super::input::{NodeView, ReportInput, State};
use super::photos::{PhotoIndex, verdicts};
use super::read::{Missing, read, unreadable};

/// What all sections share: the input, the photos by id, and the pictures embedded so far.
pub(super) struct Page<'a> {
    pub(super) input: &'a ReportInput<'a>,
    pub(super) photos: PhotoIndex,
    pub(super) pictures: Pictures,
    /// By the name of the node, each read once.
    verdicts: BTreeMap<&'a str, Result<Vec<Verdict>, Missing>>,
}

impl<'a> Page<'a> {
    pub(super) fn new(input: &'a ReportInput<'a>) -> Self {
        let judged = input
            .nodes
            .iter()
            .filter(|node| node.outputs.contains_key(VERDICTS));
        Self {
            verdicts: judged
                .map(|node| (node.name.as_str(), verdicts(input, node)))
                .collect(),
            input,
            photos: PhotoIndex::new(input),
            pictures: Pictures::default(),
        }
    }

    /// Returns the verdicts of a node, sol by sol; none of a node without.
    pub(super) fn verdicts(&self, node: &NodeView) -> Result<&[Verdict], &Missing> {
        match self.verdicts.get(node.name.as_str()) {
            Some(verdicts) => verdicts.as_deref(),
            None => Ok(&[]),
        }
    }

    /// Nodes that have an output of this name.
    pub(super) fn with_output<'s>(&'s self, output: &'s str) -> impl Iterator<Item = &'a NodeView> + 's {
        let nodes = &self.input.nodes;
        nodes.iter().filter(move |node| node.outputs.contains_key(output))
    }

    /// Nodes that have an output whose name starts so.
    pub(super) fn with_outputs_under<'s>(
        &'s self,
        prefix: &'s str,
    ) -> impl Iterator<Item = &'a NodeView> + 's {
        let under = move |node: &&NodeView| node.outputs.keys().any(|name| name.starts_with(prefix));
        self.input.nodes.iter().filter(under)
    }

    /// Reads an output.
    pub(super) fn bytes(&self, node: &NodeView, output: &str) -> Result<Arc<[u8]>, Missing> {
        read(self.input, node, output)
    }

    /// Returns the nodes that have a document of this type.
    pub(super) fn with_document<D: Document>(&self) -> impl Iterator<Item = &'a NodeView> {
        self.input.nodes.iter().filter(|node| has_document::<D>(node))
    }

    /// Reads a document of a node.
    pub(super) fn document<D: Document>(&self, node: &NodeView) -> Result<D, Missing> {
        let bytes = self.bytes(node, D::OUTPUT)?;
        D::decode(&bytes).map_err(|error| unreadable(node, D::OUTPUT, &error))
    }

    /// Returns a sentence that no node gave something, and which nodes stopped.
    pub(super) fn absent(&self, what: &str) -> Markup {
        let stopped = |node: &&NodeView| matches!(node.state, State::Failed | State::Skipped);
        let names: Vec<String> = self.input.nodes.iter().filter(stopped).map(stopped_as).collect();
        html! {
            p.missing {
                "No node of this run gave " (what) "."
                @if !names.is_empty() { " " (names.join(", ")) "." }
            }
        }
    }
}

/// Tells whether a node is of the stage that writes this document, and has it.
pub(super) fn has_document<D: Document>(node: &NodeView) -> bool {
    node.stage == D::STAGE && node.outputs.contains_key(D::OUTPUT)
}

fn stopped_as(node: &NodeView) -> String {
    format!("{} {}", node.name, node.state.word())
}
