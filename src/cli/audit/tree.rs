//! The answer of `marf audit` as text.

use std::collections::BTreeSet;

use marf_export::iso_time;
use marf_progress::duration;
use marf_provenance::find::{Maker, Place};
use marf_run::audit::identity::Identity;
use marf_run::audit::{AuditReport, Changed, Origin, ProductLine, Products, Step};

use super::uses;

macro_rules! line {
    ($text:expr, $($rest:tt)*) => { $text.push(format!($($rest)*)) };
}

/// Returns the answer as text: the identity of the file, its makers, the tree, and what was verified.
pub(super) fn text(report: &AuditReport) -> Vec<String> {
    let mut text = verdict(&report.identity);
    text[0] = format!("{}: {}", report.file.display(), text[0]);
    if let Some(found) = &report.uses {
        for tainted in &found.runs {
            let mut lines = uses::text(tainted);
            lines[0] = format!("used in {}", lines[0]);
            text.extend(lines);
        }
    }
    for origin in &report.lineage {
        line!(text, "");
        add_origin(&mut text, origin);
    }
    if let Some(verified) = &report.verified {
        line!(text, "");
        line!(
            text,
            "verified {} objects, {:.1} MB, {} files of archives by SHA-256: {} faults, {} not in the store",
            verified.objects,
            verified.bytes as f64 / 1e6,
            verified.products,
            verified.faults.len(),
            verified.missing.len()
        );
        for fault in &verified.faults {
            let object = fault.object.map(|object| object.short()).unwrap_or_default();
            line!(text, "  {} {object}: {}", fault.of, fault.what);
        }
        for lost in &verified.missing {
            line!(
                text,
                "  {} of {} ({}) is not in the store",
                lost.role,
                lost.of,
                lost.digest.short()
            );
        }
    }
    report
        .changed
        .iter()
        .for_each(|changed| add_changed(&mut text, changed));
    text
}

fn verdict(identity: &Identity) -> Vec<String> {
    match identity {
        Identity::Whole { object, makers } => {
            let several = match makers.len() {
                1 => String::new(),
                count => format!(", {count} makers, all listed"),
            };
            let is = if identity.is_input() {
                "read by marf and unaltered"
            } else {
                "made by marf and whole"
            };
            vec![format!("{is}, blake3 {object}{several}")]
        }
        Identity::Altered {
            content,
            closest,
            share,
            because,
            ..
        } => {
            let share =
                share.map(|share| format!(", {:.1} % of the bytes are the same", floor_percent(share)));
            let share = share.unwrap_or_default();
            vec![
                format!("altered: {because}"),
                format!("  it has blake3 {content}, the closest object {closest}{share}"),
            ]
        }
        Identity::Elsewhere { object, run } => vec![
            "a whole copy, by its mark, of an object that this store does not have (of another store, or collected)"
                .to_owned(),
            format!("  object {object}"),
            format!("  run root {run}"),
        ],
        Identity::NotOurs { content } => {
            vec![format!("not made by a run of this store, blake3 {content}")]
        }
    }
}

/// Returns a share in percent, rounded down, so that a file that differs never shows as the same.
fn floor_percent(share: f64) -> f64 {
    (share * 1000.0).floor() / 10.0
}

/// Returns the place that a content has in a run.
pub(super) fn place(place: &Place) -> String {
    match place {
        Place::Root => "the run root".to_owned(),
        Place::Document(name) => format!("the document `{name}` of the run"),
        Place::Output(output) => format!("output `{}` of node `{}`", output.output, output.node),
        Place::Action(node) => format!("the action of node `{node}`"),
        Place::Sol { node, output, sol } => format!("sol {sol} of output `{output}` of node `{node}`"),
        Place::Product { node, sol, id, role } => {
            format!("the {role} of product {id} of sol {sol}, read by node `{node}`")
        }
        Place::File { node, sol, file } => format!("the file {file} of sol {sol}, met by node `{node}`"),
        Place::Stored(node) => format!("stored by node `{node}` next to its outputs"),
    }
}

fn add_origin(text: &mut Vec<String>, origin: &Origin) {
    line!(text, "{}", place(&origin.maker.place));
    let is_input = matches!(origin.maker.place, Place::Product { .. } | Place::File { .. });
    let by = match origin.maker.made_in {
        _ if is_input => "read in",
        Some(_) => "made in",
        None => "the run that made it is gone. The oldest that has it is",
    };
    line!(
        text,
        "  {by} run {} of {}: {}",
        origin.run,
        iso_time(origin.started_unix_s),
        origin.command
    );
    if let Some(build) = &origin.build {
        let commit = build.commit.as_deref().unwrap_or("unknown");
        let (os, arch, file) = (&build.os, &build.arch, build.blake3.short());
        line!(
            text,
            "  by {}, commit {commit}, {os} {arch}, program file {file}",
            origin.program
        );
    } else {
        line!(text, "  by {}", origin.program);
    }
    if let Some(root) = origin.root {
        line!(text, "  run root {root}{}", others(&origin.maker, origin.run));
    }
    let mut tree = Tree {
        origin,
        shown: BTreeSet::new(),
    };
    match origin.maker.place.node() {
        Some(node) => tree.add(text, node, "", ""),
        None => {
            let ends: Vec<&Step> = origin.nodes.iter().filter(|step| tree.is_end(step)).collect();
            ends.iter().for_each(|step| tree.add(text, &step.node, "", ""));
        }
    }
}

fn others(maker: &Maker, run: u64) -> String {
    let others: Vec<String> = maker
        .runs
        .iter()
        .filter(|number| **number != run)
        .map(ToString::to_string)
        .collect();
    if others.is_empty() {
        return String::new();
    }
    format!(", also in runs {}", others.join(", "))
}

/// The nodes of a lineage as a tree. A node that several others read is printed once.
struct Tree<'a> {
    origin: &'a Origin,
    shown: BTreeSet<&'a str>,
}

impl<'a> Tree<'a> {
    /// Returns whether no other node reads anything of a node.
    fn is_end(&self, step: &Step) -> bool {
        let reads = |other: &Step| {
            let mut makers = other.inputs.values().filter_map(|input| input.made_by.as_ref());
            makers.any(|made_by| made_by.node == step.node)
        };
        step.parent.is_none() && !self.origin.nodes.iter().any(reads)
    }

    fn add(&mut self, text: &mut Vec<String>, name: &str, edge: &str, indent: &str) {
        let origin = self.origin;
        let Some(step) = origin.nodes.iter().find(|step| step.node == name) else {
            line!(text, "{indent}{edge}{name}");
            return;
        };
        if !self.shown.insert(&step.node) {
            line!(text, "{indent}{edge}{name} (above)");
            return;
        }
        line!(text, "{indent}{edge}{}", about(step));
        let below = if edge.is_empty() {
            indent.to_owned()
        } else {
            format!("{indent}  ")
        };
        for lost in &step.lost {
            line!(text, "{below}  {lost} is not in the store any more");
        }
        let children = origin
            .nodes
            .iter()
            .filter(|child| child.parent.as_deref() == Some(name));
        let children: Vec<&str> = children.map(|child| child.node.as_str()).collect();
        for child in children {
            self.add(text, child, "child: ", &format!("{below}  "));
        }
        for (input, found) in &step.inputs {
            let count = found
                .photos
                .map(|photos| format!(" ({photos})"))
                .unwrap_or_default();
            let edge = format!("{input}{count} <- ");
            match &found.made_by {
                Some(made_by) => self.add(text, &made_by.node, &edge, &format!("{below}  ")),
                None => line!(text, "{below}  {edge}{}", found.digest.short()),
            }
        }
        for source in origin.sources.iter().filter(|source| source.node == name) {
            add_products(text, source, &format!("{below}  "));
        }
    }
}

fn about(step: &Step) -> String {
    let version = step
        .version
        .map(|version| format!(" v{version}"))
        .unwrap_or_default();
    let device = step.device.as_deref().unwrap_or("device unknown");
    let key = step.key.map(|key| key.short()).unwrap_or_default();
    let seed = step
        .params
        .get("seed")
        .map(|seed| format!(", seed {seed}"))
        .unwrap_or_default();
    format!(
        "{} ({}{version}, {device}, {}{seed}, key {key})",
        step.node,
        step.stage,
        duration(step.seconds)
    )
}

fn add_products(text: &mut Vec<String>, source: &Products, indent: &str) {
    line!(text, "{indent}{} photos of {} sols:", source.photos, source.sols);
    for product in &source.listed {
        line!(text, "{indent}  {} of sol {}", product.id, product.sol);
        for (role, digest) in &product.blobs {
            line!(
                text,
                "{indent}    {role} blake3 {digest}{}",
                file_of(product, role)
            );
        }
    }
    let rest = source.photos.saturating_sub(source.listed.len() as u64);
    if rest > 0 {
        line!(text, "{indent}  and {rest} more, which --products lists");
    }
    for sol in &source.lost_sols {
        line!(
            text,
            "{indent}  the products of sol {sol} are not in the store any more"
        );
    }
}

/// Returns the origin of a blob of a product, as the end of a line. It is empty for a blob that was made here.
fn file_of(product: &ProductLine, role: &str) -> String {
    let Some(file) = product.files.get(role) else {
        return String::new();
    };
    let sha256 = file
        .sha256
        .map(|sha256| format!(", sha256 {sha256}"))
        .unwrap_or_default();
    let bytes = file
        .bytes
        .map(|bytes| format!(", {bytes} bytes"))
        .unwrap_or_default();
    let from = match (&file.url, &file.fetched) {
        (Some(url), Some(time)) => format!(", from {url} at {time}"),
        (None, Some(time)) => format!(", with the listing at {time}"),
        _ => String::new(),
    };
    format!("{sha256}{bytes}, file {}{from}", file.file)
}

fn add_changed(text: &mut Vec<String>, changed: &Changed) {
    line!(
        text,
        "{} of sol {}, used was blake3 {}:",
        changed.file,
        changed.sol,
        changed.used
    );
    for now in &changed.now {
        line!(text, "  {now}");
    }
}
