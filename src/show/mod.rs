//! report.html: what ran, what was kept, how good it is.
//!
//! One file, complete in itself: pictures as data URIs, charts as inline SVG, no script, no request to
//! anywhere. Invariant: no text of the outside (file names, labels, reasons) reaches the page unescaped, and
//! an output that is absent or unreadable is said in words in its place.

mod axis;
mod cameras;
mod curves;
mod embed;
mod format;
mod funnel;
mod gallery;
mod graph;
mod json;
mod maps;
mod nodes;
mod page;
mod photos;
mod pictures;
mod quality;
mod review;
mod sizes;
mod tune;
mod vector;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod real;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;

use marf_cache::Digest;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use page::Page;
pub use review::{Call, FACTORS, calls, percent};

/// Looks up the bytes of a digest; `None` where the store does not have them.
pub type ReadBlob<'a> = dyn Fn(&Digest) -> Option<Arc<[u8]>> + 'a;

/// What a report is made of.
pub struct ReportInput<'a> {
    /// Name of the pipeline.
    pub pipeline: String,
    /// The command line that ran it.
    pub command: String,
    /// When the run started, RFC 3339; only shown.
    pub started: String,
    /// Name and version of the program.
    pub program: String,
    /// The nodes, in any order; producers before consumers reads best.
    pub nodes: Vec<NodeView>,
    /// The store.
    pub read: &'a ReadBlob<'a>,
    /// Where pictures as they are embedded are kept from report to report.
    pub memos: &'a dyn marf_stage::Memos,
}

/// A node of the pipeline as the run left it.
#[derive(Debug, Clone)]
pub struct NodeView {
    /// Name in pipeline.toml.
    pub name: String,
    /// Name of its stage.
    pub stage: String,
    /// One line about the stage.
    pub about: String,
    /// (Key of the port, name of the upstream node).
    pub upstream: Vec<(String, String)>,
    /// What became of it.
    pub state: State,
    /// Why it ran, was reused or skipped; of a failed node the message.
    pub reason: String,
    /// Wall time of its work, seconds; of a reused node what it took then, if known.
    pub seconds: Option<f64>,
    /// Its parameters.
    pub params: serde_json::Value,
    /// Its outputs by name.
    pub outputs: BTreeMap<String, Digest>,
    /// The nodes it asked for.
    pub children: Vec<ChildView>,
}

/// A node that another node asked for: a tuning trial, a retraining.
#[derive(Debug, Clone)]
pub struct ChildView {
    /// Name below the asking node.
    pub name: String,
    /// What became of it.
    pub state: State,
    /// Wall time of its work, seconds.
    pub seconds: Option<f64>,
}

/// What became of a node in this run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Worked in this run.
    Ran,
    /// Its outputs were there already.
    Reused,
    /// Stopped with an error.
    Failed,
    /// Not reached, since something before it failed or it was not asked for.
    Skipped,
}

impl State {
    /// The state as a word, also its class in the style sheet.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ran => "ran",
            Self::Reused => "reused",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
        }
    }
}

/// Writes the report as one HTML file. Equal input gives equal bytes; nothing in it can make it panic.
pub fn write(input: &ReportInput<'_>) -> String {
    let page = Page::new(input);
    let sections = sections(&page);
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy"
                    content="default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'";
                meta name="viewport" content="width=device-width";
                title { (input.pipeline) ", marf report" }
                style { (PreEscaped(include_str!("style.css"))) }
            }
            body {
                (header(&page, &sections))
                main { @for section in &sections { (section.shown()) } }
                footer { (input.program) ", run started " (input.started) "." }
            }
        }
    }
    .into_string()
}

/// A part of the page that the contents list leads to.
struct Section {
    id: &'static str,
    title: &'static str,
    body: Markup,
}

impl Section {
    fn shown(&self) -> Markup {
        html! { section id=(self.id) { h2 { (self.title) } (self.body) } }
    }
}

fn sections(page: &Page<'_>) -> Vec<Section> {
    let section = |id, title, body| Section { id, title, body };
    let mut sections = vec![
        section("graph", "Pipeline", graph::body(page)),
        section("nodes", "Nodes", nodes::body(page)),
        section("funnel", "Filters", funnel::body(page)),
        section("rejected", "Rejected photos", gallery::rejected(page)),
        section("kept", "Kept photos", gallery::kept(page)),
        section("review", "How firm the verdicts are", review::body(page)),
    ];
    if filters_alone(page.input) {
        return sections;
    }
    sections.extend([
        section("cameras", "Cameras", cameras::body(page)),
        section("tune", "Tuning", tune::body(page)),
        section("training", "Training", curves::body(page)),
        section("heldout", "Held-out photos", pictures::held_out(page)),
        section("uncertainty", "Uncertainty", maps::body(page)),
        section("flight", "Fly-through", pictures::flights(page)),
    ]);
    sections
}

/// Tells whether the pipeline only finds and judges photos, so that nothing is to be said of a scene.
fn filters_alone(input: &ReportInput<'_>) -> bool {
    let stages = marf_stages::stages();
    let judges = |node: &NodeView| {
        let def = stages.iter().find(|def| def.name == node.stage);
        def.is_some_and(|def| def.outputs.contains(&marf_stage::VERDICTS))
    };
    !input.nodes.is_empty() && input.nodes.iter().all(judges)
}

fn header(page: &Page<'_>, sections: &[Section]) -> Markup {
    let input = page.input;
    html! {
        header {
            h1 { (input.pipeline) }
            p.lead { (nodes::sentence(input)) }
            p.quiet { code { (input.command) } ", started " (input.started) ", " (input.program) }
            (nodes::failures(input))
            nav aria-label="Contents" {
                @for section in sections { a href={ "#" (section.id) } { (section.title) } " " }
            }
        }
    }
}
