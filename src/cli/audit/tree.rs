//! The answer of `marf audit` as text.

use std::collections::BTreeSet;

use marf_export::iso_time;
use marf_export::verify::{Role, Trace};
use marf_progress::format::{count, duration, size};
use marf_provenance::find::{Maker, Place};
use marf_provenance::verify::Verified;
use marf_run::audit::identity::Identity;
use marf_run::audit::{AuditReport, Changed, Detail, Origin, Product, Products, Step};

use super::{sentence, uses};

/// Adds a line.
macro_rules! line {
    ($text:expr, $($rest:tt)*) => {{ $text.push(format!($($rest)*)); }};
}

/// Most steps, runs and photos of a short answer.
const MOST: usize = 8;

/// Returns the answer as text: a sentence, what was verified, where the file was used, and its lineage.
pub(super) fn text(report: &AuditReport, detail: Detail) -> Vec<String> {
    let mut text = Vec::new();
    line!(text, "{}", sentence::answer(report));
    if let Some(verified) = &report.verified {
        add_verified(&mut text, verified);
    }
    report
        .changed
        .iter()
        .for_each(|changed| add_changed(&mut text, changed));
    line!(text, "");
    line!(text, "{}", report.file.display());
    text.extend(bytes_text(&report.identity));
    match detail {
        Detail::All => {
            let runs = report.uses.iter().flat_map(|uses| &uses.runs);
            for run in runs {
                let mut lines = uses::text(run);
                lines[0] = format!("used in {}", lines[0]);
                text.extend(lines);
            }
            report
                .lineage
                .iter()
                .for_each(|origin| add_origin(&mut text, origin));
        }
        Detail::Short => add_short(&mut text, report),
    }
    text
}

/// Adds the first maker with its first steps, and how many there are.
fn add_short(text: &mut Vec<String>, report: &AuditReport) {
    if let Some(found) = &report.uses {
        for run in found.runs.iter().take(MOST) {
            line!(
                text,
                "  used by {} of run {}",
                count(run.nodes.len(), "node"),
                run.run
            );
        }
        add_rest(text, found.runs.len(), "runs");
    }
    let Some(origin) = report.lineage.first() else {
        return;
    };
    add_head(text, origin);
    let steps = origin.nodes.iter().filter(|step| step.parent.is_none());
    let steps: Vec<&Step> = steps.rev().collect();
    for step in steps.iter().take(MOST) {
        line!(text, "    {}", about(step));
    }
    add_rest(text, steps.len(), "steps");
    line!(text, "`--all` lists every input, product and digest");
}

fn add_rest(text: &mut Vec<String>, all: usize, what: &str) {
    let rest = all.saturating_sub(MOST);
    if rest > 0 {
        line!(text, "    and {rest} more {what}");
    }
}

/// Returns the answer of a crate as text: a sentence, the run, its steps and photos.
pub(super) fn crate_text(trace: &Trace, detail: Detail) -> Vec<String> {
    let most = match detail {
        Detail::All => usize::MAX,
        Detail::Short => MOST / 2,
    };
    let mut text = Vec::new();
    line!(text, "{}", sentence::answer_of_crate(trace));
    line!(text, "");
    for role in trace.is.iter().take(most) {
        match role {
            Role::Output { node, output } => line!(text, "output `{output}` of node `{node}`"),
            Role::Photo { id, role } => line!(text, "{role} of photo `{id}`"),
        }
    }
    line!(
        text,
        "  run {} of {}: {}",
        trace.run,
        trace.pipeline,
        trace.command
    );
    for step in trace.steps.iter().rev().take(most) {
        let (stage, version) = (&step.action.stage, step.action.version);
        line!(text, "  {} ({stage} v{version}), key {}", step.node, step.key);
        let reads = step.reads.iter().filter(|_| detail == Detail::All);
        for (input, maker) in reads {
            line!(text, "    {input} from {}", maker.as_deref().unwrap_or("outside"));
        }
    }
    for product in trace.products.iter().take(most) {
        line!(text, "  photo {}", product.id);
        let files = product.files.iter().filter(|_| detail == Detail::All);
        for file in files {
            let from = file.url.as_deref().unwrap_or(&file.file);
            line!(text, "    {from}, blake3 {}", file.blake3);
        }
    }
    if detail == Detail::Short {
        let (steps, photos) = (
            count(trace.steps.len(), "step"),
            count(trace.products.len(), "photo"),
        );
        line!(text, "`--all` lists the inputs and files of {steps} and {photos}");
    }
    text
}

fn add_verified(text: &mut Vec<String>, verified: &Verified) {
    line!(
        text,
        "checked {} ({}), {} by SHA-256: {}, {} missing",
        count(verified.objects as usize, "object"),
        size(verified.bytes),
        count(verified.products as usize, "archive file"),
        count(verified.faults.len(), "fault"),
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

/// Returns the digest of the file's bytes, and which object it is or resembles.
fn bytes_text(identity: &Identity) -> Vec<String> {
    match identity {
        Identity::Whole { object, makers } => {
            let makers = match makers.len() {
                0 | 1 => String::new(),
                number => format!(", made by {number} nodes or runs"),
            };
            vec![format!("  blake3 {object}{makers}")]
        }
        Identity::Altered { content, closest, .. } => {
            vec![
                format!("  blake3 {content}"),
                format!("  closest original {closest}"),
            ]
        }
        Identity::Elsewhere { object, run } => {
            vec![format!("  blake3 {object}"), format!("  run root {run}")]
        }
        Identity::NotOurs { content } => vec![format!("  blake3 {content}")],
    }
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

/// Adds what a maker made, in which run, by which program.
fn add_head(text: &mut Vec<String>, origin: &Origin) {
    line!(text, "  {}", place(&origin.maker.place));
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
}

fn add_origin(text: &mut Vec<String>, origin: &Origin) {
    line!(text, "");
    add_head(text, origin);
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
                None => {
                    line!(text, "{below}  {edge}{}", found.digest.short());
                }
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
    let photos = count(source.photos as usize, "photo");
    line!(text, "{indent}{photos} of {}:", count(source.sols, "sol"));
    for product in &source.listed {
        line!(text, "{indent}  {} of sol {}", product.id, product.shard);
        for (role, digest) in &product.blobs {
            line!(
                text,
                "{indent}    {role} blake3 {digest}{}",
                file_of(product, role)
            );
        }
    }
    for sol in &source.lost_sols {
        line!(
            text,
            "{indent}  the products of sol {sol} are not in the store any more"
        );
    }
}

/// Returns the origin of a blob of a product, as the end of a line. It is empty for a blob that was made here.
fn file_of(product: &Product, role: &str) -> String {
    let Some(file) = product.origins.get(role) else {
        return String::new();
    };
    let sha256 = file
        .sha256
        .map(|sha256| format!(", sha256 {sha256}"))
        .unwrap_or_default();
    let bytes = file
        .bytes
        .map(|bytes| format!(", {}", size(bytes)))
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

#[cfg(test)]
mod tests;
