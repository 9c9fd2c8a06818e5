use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use marf_model::RunNode;
use marf_schema::train;
use marf_stage::{Document, PHOTOS, VERDICTS};
use maud::{Markup, html};

use super::embed::Pictures;
use super::media::Media;
use super::photos::{Kept, PhotoIndex, Spot, last_photo_nodes};
use super::read::{Missing, read, unreadable};
use super::report::{FAILED, Report, SKIPPED, WAITING, state};
use super::sets::Set;
use super::verdicts::{ClosestCall, Summary, closest_calls};

/// Data of all sections: the report, the summary of the verdicts, the photos that are shown, and the pictures
/// shown so far.
pub(super) struct Page<'a> {
    pub(super) report: &'a Report<'a>,
    pub(super) photos: PhotoIndex,
    pub(super) pictures: Pictures<'a>,
    /// The remaining photos, by the nodes that no other node filters further.
    pub(super) kept: Vec<(&'a RunNode, Result<Kept, Missing>)>,
    /// The closest call on each photo of `kept`.
    pub(super) closest: BTreeMap<String, ClosestCall<'a>>,
    judged: Vec<(&'a RunNode, Result<Summary, Missing>)>,
}

impl<'a> Page<'a> {
    pub(super) fn new(report: &'a Report<'a>, media: &'a Media<'a>) -> Self {
        let open = |output| {
            let nodes = report.nodes.iter().copied();
            nodes.filter_map(move |node| Some((node, Set::open(report, node, output)?)))
        };
        let verdicts: Vec<_> = open(VERDICTS).collect();
        let sum = |set: &Result<Set<'_>, Missing>| Summary::new(report, set.as_ref().map_err(Clone::clone)?);
        let judged: Vec<_> = verdicts.iter().map(|(node, set)| (*node, sum(set))).collect();
        let last = last_photo_nodes(report);
        let kept: Vec<_> = open(PHOTOS)
            .filter(|(node, _)| last.contains(&node.run.name.as_str()))
            .map(|(node, set)| (node, set.and_then(|set| Kept::new(report, &set))))
            .collect();
        let kept_spots: BTreeSet<Spot> = kept
            .iter()
            .filter_map(|(_, kept)| kept.as_ref().ok())
            .flat_map(|kept| kept.shown.iter().cloned())
            .collect();
        let summaries = judged.iter().filter_map(|(_, sum)| sum.as_ref().ok());
        let spots = summaries
            .flat_map(Summary::spots)
            .chain(kept_spots.iter().cloned());
        Self {
            photos: PhotoIndex::new(open(PHOTOS).map(|(_, set)| set), spots),
            pictures: Pictures::new(media),
            closest: closest_calls(
                verdicts.iter().filter_map(|(_, set)| set.as_ref().ok()),
                &kept_spots,
            ),
            kept,
            judged,
            report,
        }
    }

    /// Returns the nodes that gave verdicts, with these summed up.
    pub(super) fn judged(&self) -> impl Iterator<Item = (&'a RunNode, Result<&Summary, &Missing>)> {
        self.judged.iter().map(|(node, sum)| (*node, sum.as_ref()))
    }

    /// Nodes that have an output of this name.
    pub(super) fn with_output<'s>(&'s self, output: &'s str) -> impl Iterator<Item = &'a RunNode> + 's {
        let nodes = self.report.nodes.iter().copied();
        nodes.filter(move |node| node.digest(output).is_some())
    }

    /// Nodes that have an output whose name starts so.
    pub(super) fn with_outputs_under<'s>(
        &'s self,
        prefix: &'s str,
    ) -> impl Iterator<Item = &'a RunNode> + 's {
        let nodes = self.report.nodes.iter().copied();
        nodes.filter(move |node| node.outputs_under(prefix).next().is_some())
    }

    /// Reads an output.
    pub(super) fn bytes(&self, node: &RunNode, output: &str) -> Result<Arc<[u8]>, Missing> {
        read(self.report, node, output)
    }

    /// Returns the nodes that have a document of this type.
    pub(super) fn with_document<D: Document>(&self) -> impl Iterator<Item = &'a RunNode> {
        let nodes = self.report.nodes.iter().copied();
        nodes.filter(|node| has_document::<D>(node))
    }

    /// Returns the training whose field is shown first: the last one that has a result.
    pub(super) fn training(&self) -> Option<&'a RunNode> {
        self.with_document::<train::Metrics>().last()
    }

    /// Returns the training that a training stands in for as a draft: the next one on the same cameras, which has no result yet.
    pub(super) fn awaited(&self, draft: &RunNode) -> Option<&'a RunNode> {
        self.later_trainings(draft)
            .find(|node| !has_document::<train::Metrics>(node))
    }

    /// Returns true if a training was a draft that no node reads, and a later one on the same cameras has a result.
    pub(super) fn is_replaced(&self, draft: &RunNode) -> bool {
        let reads = |node: &&RunNode| node.upstream().any(|name| name == draft.run.name);
        self.later_trainings(draft).any(has_document::<train::Metrics>)
            && !self.report.nodes.iter().any(reads)
    }

    /// Returns the trainings after a training on the same cameras.
    fn later_trainings(&self, first: &RunNode) -> impl Iterator<Item = &'a RunNode> {
        let cameras = |node: &RunNode| {
            let mut edges = node.run.edges.iter();
            let input = edges.find(|edge| edge.key == "input");
            input.map(|edge| edge.upstream.clone())
        };
        let (name, of_first) = (first.run.name.clone(), cameras(first));
        let is_training = first.run.stage == <train::Metrics as Document>::STAGE;
        let nodes = self.report.nodes.iter().copied();
        nodes
            .skip_while(move |node| node.run.name != name)
            .skip(1)
            .filter(move |node| {
                is_training
                    && node.run.stage == <train::Metrics as Document>::STAGE
                    && cameras(node) == of_first
            })
    }

    /// Reads a document of a node.
    pub(super) fn document<D: Document>(&self, node: &RunNode) -> Result<D, Missing> {
        let bytes = self.bytes(node, D::OUTPUT)?;
        D::decode(&bytes).map_err(|error| unreadable(node, D::OUTPUT, &error))
    }

    /// Returns a sentence that no node gave something, and which nodes stopped.
    pub(super) fn absent(&self, what: &str) -> Markup {
        let stopped = |node: &&&RunNode| [FAILED, SKIPPED, WAITING].contains(&state(node));
        let stopped = self.report.nodes.iter().filter(stopped);
        let names: Vec<String> = stopped
            .map(|node| format!("{} {}", node.run.name, state(node)))
            .collect();
        html! {
            p.missing {
                "No node of this run gave " (what) "."
                @if !names.is_empty() { " " (names.join(", ")) "." }
            }
        }
    }
}

/// Returns true if a node is of the stage that writes this document, and has it.
pub(super) fn has_document<D: Document>(node: &RunNode) -> bool {
    node.run.stage == D::STAGE && node.digest(D::OUTPUT).is_some()
}

/// An entry of a legend, which no line break parts: a swatch of a class and what it means.
pub(super) fn key(class: &str, meaning: &str) -> Markup {
    html! { span { span.key.(class) {} (meaning) } }
}
