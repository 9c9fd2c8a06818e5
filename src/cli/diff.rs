//! `marf diff`: what changed between two runs, node by node.

use clap::Args;
use marf_cache::{Digest, Store};
use marf_engine::Cancel;
use marf_provenance::diff::{NodeDiff, Presence, ProductsDiff, diff as nodes};
use marf_provenance::lineage::Lineage;
use marf_scene::Photo;
use serde::Serialize;

use super::args::Global;
use super::error::CliError;
use super::output::print_json;
use super::session::existing_store;
use crate::terminal::{escape_control, print_line};

/// Arguments of `diff`.
#[derive(Debug, Clone, Args)]
pub struct DiffArgs {
    /// Number of the first run
    pub first: u64,
    /// Number of the second run
    pub second: u64,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
struct Report {
    runs: (u64, u64),
    nodes: Vec<Node>,
}

#[derive(Debug, Serialize)]
struct Node {
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

/// `marf diff`: prints parameters, products, metrics and pictures that differ between two runs.
pub fn diff(global: &Global, args: &DiffArgs, cancel: &Cancel) -> Result<(), CliError> {
    let store = existing_store(global, cancel)?;
    let (first, second) = (
        Lineage::open(&store, args.first)?,
        Lineage::open(&store, args.second)?,
    );
    let with_pictures = |diff: NodeDiff| Node {
        pictures: pictures(&store, &diff),
        diff,
    };
    let report = Report {
        runs: (args.first, args.second),
        nodes: nodes(&first, &second)?.into_iter().map(with_pictures).collect(),
    };
    if global.json {
        return print_json(&report);
    }
    for node in &report.nodes {
        print_line(&escape_control(&text(node)));
    }
    let all = second.nodes.len();
    print_line(&format!(
        "{} of {all} nodes differ between runs {} and {}",
        report.nodes.len(),
        args.first,
        args.second
    ));
    Ok(())
}

/// Compares the pictures of a node that both runs have in the same size.
fn pictures(store: &Store, diff: &NodeDiff) -> Vec<Picture> {
    let read = |digest: &Digest| Photo::decode(&store.get(digest).ok()?).ok();
    let compared = diff
        .outputs
        .iter()
        .filter(|(name, _)| name.ends_with(".png"))
        .filter_map(|(name, of)| {
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
        });
    compared.collect()
}

/// Most values, products or pictures that have a line of their own.
const MOST: usize = 8;

fn text(node: &Node) -> String {
    let diff = &node.diff;
    let presence = match diff.presence {
        Presence::Both => "",
        Presence::First => " is in the first run alone",
        Presence::Second => " is in the second run alone",
    };
    let mut lines = vec![format!("{}{presence}", diff.node)];
    let mut add = |all: Vec<String>| {
        let more = all.len().saturating_sub(MOST);
        lines.extend(all.into_iter().take(MOST).map(|line| format!("  {line}")));
        if more > 0 {
            lines.push(format!("  and {more} more, which --json lists"));
        }
    };
    add(diff.changes.iter().map(ToString::to_string).collect());
    add(products(&diff.products));
    for (output, values) in &diff.values {
        add(values.iter().map(|value| format!("{output}: {value}")).collect());
    }
    let picture = |picture: &Picture| {
        let (share, most) = (100.0 * picture.share, picture.most);
        format!(
            "{}: {share:.1} % of the pixels differ, by at most {most} of 255",
            picture.output
        )
    };
    add(node.pictures.iter().map(picture).collect());
    lines.join("\n")
}

fn products(products: &ProductsDiff) -> Vec<String> {
    let lines =
        |word: &str, ids: &[String]| -> Vec<String> { ids.iter().map(|id| format!("{word} {id}")).collect() };
    [
        lines("product in:", &products.added),
        lines("product out:", &products.removed),
        lines("product edited:", &products.edited),
    ]
    .concat()
}
