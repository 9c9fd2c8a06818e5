//! Differences between two runs, node by node.

use std::fmt;

use marf_cache::{Digest, Store};
use marf_engine::Change;
use marf_model::{Run, RunError};
use marf_provenance::diff::{NodeDiff, Presence, diff as nodes};
use marf_provenance::difference::value_text;
use marf_scene::Photo;
use serde::Serialize;

use crate::context::Context;
use crate::error::Error;

/// What differs between two runs.
#[derive(Debug, Serialize)]
pub struct RunDiff {
    /// Numbers of the runs.
    pub runs: (u64, u64),
    /// The nodes that differ.
    pub nodes: Vec<NodeChanges>,
    /// How many nodes the second run has.
    #[serde(skip)]
    pub of_nodes: usize,
}

/// Compares two runs by their numbers.
///
/// # Errors
/// A run that cannot be read.
pub fn diff(context: &Context, first: u64, second: u64) -> Result<RunDiff, Error> {
    let store = context.existing_store()?;
    let before = Run::open(&store, first)?;
    let after = Run::open(&store, second)?;
    Ok(RunDiff {
        runs: (first, second),
        nodes: compare(&before, &after, usize::MAX)?,
        of_nodes: after.nodes.len(),
    })
}

/// The changes of a node between two runs.
#[derive(Debug, Serialize)]
pub struct NodeChanges {
    #[serde(flatten)]
    diff: NodeDiff,
    /// Pictures of the same size that both runs have.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pictures: Vec<Picture>,
}

/// How two pictures differ.
#[derive(Debug, Serialize)]
struct Picture {
    output: String,
    /// Share of the pixels that differ, in [0, 1].
    share: f64,
    /// Largest difference of a channel, of 255.
    most: u8,
}

/// Returns the nodes that differ between two runs of a store, in the order of the second. `most_pictures` is the number of pictures of a
/// node that are decoded and compared.
///
/// # Errors
/// A store that cannot be read.
pub fn compare(
    first: &Run<'_>,
    second: &Run<'_>,
    most_pictures: usize,
) -> Result<Vec<NodeChanges>, RunError> {
    let with_pictures = |diff: NodeDiff| NodeChanges {
        pictures: pictures(second.store(), &diff).take(most_pictures).collect(),
        diff,
    };
    Ok(nodes(first, second)?.into_iter().map(with_pictures).collect())
}

/// Compares the pictures of a node that both runs have in the same size.
fn pictures(store: &Store, diff: &NodeDiff) -> impl Iterator<Item = Picture> {
    let read = |digest: &Digest| Photo::decode(&store.get(digest).ok()?).ok();
    diff.outputs
        .iter()
        .filter(|(name, _)| name.ends_with(".png"))
        .filter_map(move |(name, of)| {
            let (was, is) = (read(&of.0?)?.image, read(&of.1?)?.image);
            if (was.width, was.height) != (is.width, is.height) {
                return None;
            }
            let steps = was
                .pixels
                .iter()
                .zip(&is.pixels)
                .map(|(was, is)| was.iter().zip(is).map(|(a, b)| a.abs_diff(*b)).max());
            let steps: Vec<u8> = steps.map(Option::unwrap_or_default).collect();
            let differing = steps.iter().filter(|step| **step > 0).count();
            Some(Picture {
                output: name.clone(),
                share: differing as f64 / steps.len().max(1) as f64,
                most: steps.into_iter().max().unwrap_or_default(),
            })
        })
}

/// Most values, products or pictures of a node that have a line of their own.
pub const MOST: usize = 8;

impl NodeChanges {
    /// Returns the node and how much of it differs. `first` and `second` are what the runs are called.
    pub fn heading(&self, first: &str, second: &str) -> String {
        let diff = &self.diff;
        let products = &diff.products;
        let counts = [
            (products.added.len(), "products in"),
            (products.removed.len(), "products out"),
            (products.edited.len(), "products edited"),
            (diff.outputs.len(), "outputs differ"),
        ];
        let counts = counts.iter().filter(|(count, _)| *count > 0);
        let counts: Vec<String> = counts.map(|(count, what)| format!("{count} {what}")).collect();
        let what = match diff.presence {
            Presence::First => format!("in {first} alone"),
            Presence::Second => format!("in {second} alone"),
            Presence::Both if counts.is_empty() => "the outputs are equal".to_owned(),
            Presence::Both => counts.join(", "),
        };
        format!("{}: {what}", diff.node)
    }

    /// Returns parameters, products, values and pictures that differ, a line each, the first [`MOST`] of each kind.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let mut add = |all: Vec<String>| {
            let more = all.len().saturating_sub(MOST);
            lines.extend(all.into_iter().take(MOST));
            lines.extend((more > 0).then(|| format!("and {more} more")));
        };
        add(self.diff.changes.iter().map(ToString::to_string).collect());
        let products = &self.diff.products;
        for (word, ids) in [
            ("in", &products.added),
            ("out", &products.removed),
            ("edited", &products.edited),
        ] {
            add(ids.iter().map(|id| format!("product {word}: {id}")).collect());
        }
        for (output, values) in &self.diff.values {
            // Means and totals come before the values that they summarise.
            let mut values: Vec<&Change> = values.iter().collect();
            values.sort_by_key(|value| value.path.matches('.').count());
            let line = |value: &&Change| format!("{output}: {}", value_text(value));
            add(values.iter().map(line).collect());
        }
        add(self.pictures.iter().map(ToString::to_string).collect());
        lines
    }
}

impl fmt::Display for Picture {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (output, share, most) = (&self.output, 100.0 * self.share, self.most);
        write!(
            f,
            "{output}: {share:.1} % of the pixels differ, by at most {most} of 255"
        )
    }
}
