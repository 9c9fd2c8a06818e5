//! How many photos went into each filter, and how many came out.

use std::collections::BTreeMap;

use marf_stage::{VERDICTS, Verdict};
use maud::{Markup, html};

use super::format::{count, cut, px};
use super::input::NodeView;
use super::page::Page;
use super::read::Missing;

const BAR_LEFT: f64 = 150.0;
const BAR_WIDTH: f64 = 440.0;
const BAR_HEIGHT: f64 = 20.0;
const PITCH: f64 = 30.0;
const WIDTH: f64 = 1040.0;

/// What one node did to the set.
struct Step<'a> {
    node: &'a NodeView,
    counts: Result<Counts, Missing>,
}

struct Counts {
    seen: usize,
    kept: usize,
    /// Kind of the verdict and how often it fell.
    rejected: BTreeMap<String, usize>,
}

impl Counts {
    fn new(verdicts: &[Verdict]) -> Self {
        let mut rejected = BTreeMap::new();
        for verdict in verdicts.iter().filter(|verdict| !verdict.keeps()) {
            *rejected.entry(verdict.verdict.clone()).or_insert(0) += 1;
        }
        Self {
            seen: verdicts.len(),
            kept: verdicts.iter().filter(|verdict| verdict.keeps()).count(),
            rejected,
        }
    }

    fn sentence(&self) -> String {
        let kinds: Vec<String> = self
            .rejected
            .iter()
            .map(|(kind, number)| format!("{number} {}", cut(kind, 24)))
            .collect();
        let rejected = self.seen - self.kept;
        match rejected {
            0 => format!("{} in, all kept", self.seen),
            _ => format!(
                "{} in, {} kept, {rejected} rejected ({})",
                self.seen,
                self.kept,
                kinds.join(", ")
            ),
        }
    }
}

/// Draws the funnel and lists the files that could not be read.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let steps: Vec<Step<'_>> = page
        .with_output(VERDICTS)
        .map(|node| Step {
            node,
            counts: page.verdicts(node).map(Counts::new).map_err(Clone::clone),
        })
        .collect();
    if steps.is_empty() {
        return page.absent("verdicts on photos");
    }
    html! {
        (drawing(&steps))
        @for step in &steps { @if let Err(missing) = &step.counts { (missing) } }
        @for missing in page.photos.missing() { (missing) }
        (undecodable(page))
    }
}

fn drawing(steps: &[Step<'_>]) -> Markup {
    let shown: Vec<(&NodeView, &Counts)> = steps
        .iter()
        .filter_map(|step| Some((step.node, step.counts.as_ref().ok()?)))
        .collect();
    let most = shown
        .iter()
        .map(|(_, counts)| counts.seen)
        .max()
        .unwrap_or(0)
        .max(1);
    let height = shown.len() as f64 * PITCH;
    html! {
        div.scroll {
            svg.funnel viewBox={ "0 0 " (px(WIDTH)) " " (px(height)) } width=(px(WIDTH)) height=(px(height))
                role="img" aria-label="Photos into and out of each filter" {
                @for (index, (node, counts)) in shown.iter().enumerate() {
                    (bar(node, counts, index as f64 * PITCH, BAR_WIDTH / most as f64))
                }
            }
        }
        p.legend { span.key.kept {} "kept " span.key.rejected {} "rejected" }
    }
}

fn bar(node: &NodeView, counts: &Counts, top: f64, px_each: f64) -> Markup {
    let kept = counts.kept as f64 * px_each;
    let seen = counts.seen as f64 * px_each;
    let base = top + 15.0;
    html! {
        g {
            title { (node.name) ": " (counts.sentence()) }
            text.name x=(px(BAR_LEFT - 10.0)) y=(px(base)) text-anchor="end" { (cut(&node.name, 18)) }
            rect.rejected x=(px(BAR_LEFT + kept)) y=(px(top)) width=(px(seen - kept)) height=(px(BAR_HEIGHT)) {}
            rect.kept x=(px(BAR_LEFT)) y=(px(top)) width=(px(kept)) height=(px(BAR_HEIGHT)) {}
            text x=(px(BAR_LEFT + seen + 10.0)) y=(px(base)) { (counts.sentence()) }
        }
    }
}

/// Files that gave no photo at all: they have no picture, only a reason.
fn undecodable(page: &Page<'_>) -> Markup {
    let files: Vec<&Verdict> = page
        .with_output(VERDICTS)
        .filter_map(|node| page.verdicts(node).ok())
        .flatten()
        .filter(|verdict| !verdict.keeps() && page.photos.get(&verdict.id).is_none())
        .collect();
    html! {
        @if !files.is_empty() {
            h3 { (count(files.len(), "file")) " that gave no photo" }
            div.scroll {
                table {
                    thead { tr { th { "File" } th { "Verdict" } th { "Why" } } }
                    tbody {
                        @for file in &files {
                            tr { td.file { (file.file) } td { (file.verdict) } td { (file.reason) } }
                        }
                    }
                }
            }
        }
    }
}
