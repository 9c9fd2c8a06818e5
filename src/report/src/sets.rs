//! Sets of photos and of verdicts as the page reads them: the list of their blocks, and of the rest what it shows.

use std::sync::Arc;

use marf_cache::Digest;
use marf_cache::manifest::{BlockRef, Leaf, LeafRef, ManifestError, Root, Row, SHARDS_A_BLOCK};
use marf_engine::sets;
use marf_model::RunNode;
use marf_stage::{PHOTOS, VERDICTS, Verdict};

use super::read::{Missing, not_stored, read, unreadable};
use super::report::Report;

/// An output of a node that is a set.
pub(super) struct Set<'a> {
    report: &'a Report<'a>,
    node: &'a RunNode,
    output: &'static str,
    /// Its blocks, sorted by number.
    pub(super) blocks: Vec<BlockRef>,
}

impl<'a> Set<'a> {
    /// Opens the photos or the verdicts of a node. `None` if it has none.
    pub(super) fn open(
        report: &'a Report<'a>,
        node: &'a RunNode,
        output: &'static str,
    ) -> Option<Result<Self, Missing>> {
        node.digest(output)?;
        let blocks = read(report, node, output)
            .and_then(|bytes| Root::blocks(&bytes).map_err(|error| unreadable(node, output, &error)));
        Some(blocks.map(|blocks| Self {
            report,
            node,
            output,
            blocks,
        }))
    }

    /// Name of the node.
    pub(super) fn node(&self) -> &'a str {
        &self.node.run.name
    }

    /// Returns true if the node takes no photos of another node.
    pub(super) fn is_of_source(&self) -> bool {
        self.node.run.edges.is_empty()
    }

    /// Number of photos or verdicts.
    pub(super) fn rows(&self) -> u64 {
        self.blocks.iter().map(|block| block.rows).sum()
    }

    /// Reads the leaves of a block.
    pub(super) fn leaves(&self, block: &BlockRef) -> Result<Vec<LeafRef>, Missing> {
        let bytes = self.part(&block.digest)?;
        Root::decode_leaves(&bytes).map_err(|error| self.unreadable(&error))
    }

    /// Reads the leaves of a sol.
    pub(super) fn leaves_of(&self, shard: u32) -> Result<Vec<LeafRef>, Missing> {
        let block = self
            .blocks
            .iter()
            .find(|block| block.block == shard / SHARDS_A_BLOCK);
        let mut leaves = block.map_or_else(|| Ok(Vec::new()), |block| self.leaves(block))?;
        leaves.retain(|leaf| leaf.shard == shard);
        Ok(leaves)
    }

    /// Reads a leaf of photos.
    pub(super) fn photos(&self, leaf: &LeafRef) -> Result<Vec<Row>, Missing> {
        debug_assert_eq!(self.output, PHOTOS);
        let leaf = Leaf::decode(&self.part(&leaf.leaf)?);
        leaf.map(|leaf| leaf.rows)
            .map_err(|error| self.unreadable(&error))
    }

    /// Reads a leaf of verdicts.
    pub(super) fn verdicts(&self, leaf: &LeafRef) -> Result<Vec<Verdict>, Missing> {
        debug_assert_eq!(self.output, VERDICTS);
        sets::parse(&self.part(&leaf.leaf)?).map_err(|error| self.unreadable(&error))
    }

    fn part(&self, digest: &Digest) -> Result<Arc<[u8]>, Missing> {
        let what = || format!("A part of {} of {}", self.output, self.node.run.name);
        (self.report.read)(digest).ok_or_else(|| Missing(not_stored(&what(), digest)))
    }

    fn unreadable(&self, error: &ManifestError) -> Missing {
        unreadable(self.node, self.output, error)
    }
}
