//! report.html: what ran, what was kept, how good it is.
//!
//! One file, complete in itself: pictures as data URIs, charts as inline SVG, no script, no request to
//! anywhere. Invariant: no text of the outside (file names, labels, reasons) reaches the page unescaped, and
//! a sentence stands in place of an output that is absent or unreadable.

mod axis;
mod call;
mod cameras;
mod changes;
mod curves;
mod embed;
pub mod emptied;
mod format;
mod funnel;
mod gallery;
mod graph;
mod ground;
mod hardware;
mod input;
mod json;
mod maps;
mod nodes;
mod page;
mod photos;
mod pictures;
mod quality;
mod read;
mod review;
mod scenes;
mod sets;
mod sizes;
mod thumbs;
mod ties;
pub mod trade;
mod tune;
mod unplaced;
mod vector;
mod verdicts;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod fixture_documents;
#[cfg(test)]
mod real;
#[cfg(test)]
mod tests;

use marf_schema::scenes::{Scenes, ScenesParams};
use marf_schema::ties::Ties;
use marf_stage::Params;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use page::Page;

pub use call::{Call, FACTORS, calls};
pub use input::{ChangedNode, Changes, ChildView, NodeView, ReadBlob, ReportInput, SceneView, State};
pub use review::percent;

/// Writes the report as one HTML file. Equal input gives equal bytes; nothing in it can make it panic.
pub fn write(input: &ReportInput<'_>) -> String {
    let page = Page::new(input);
    let sections = sections(&page);
    let title = format!("{}, marf report", input.pipeline);
    let body = html! {
        (header(&page, &sections))
        main { @for section in &sections { (section.shown()) } }
        footer { (input.program) ", run started " (input.started) "." }
    };
    document(&title, &body)
}

/// Writes a page of one sentence in the form of a report: for `marf view` while there is none.
pub fn sentence_page(sentence: &str) -> String {
    let body = html! {
        header { h1 { "marf" } p.lead { (sentence) } nav aria-label="Contents" {} }
        main {}
    };
    document("marf", &body)
}

fn document(title: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy"
                    content="default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'";
                meta name="viewport" content="width=device-width";
                title { (title) }
                style { (PreEscaped(include_str!("style.css"))) }
            }
            body { (body) }
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
        section("changes", "What changed", changes::body(page)),
    ];
    if page.input.whole.is_none() {
        sections.extend([
            section("funnel", "Filters", funnel::body(page)),
            section("rejected", "Rejected photos", gallery::rejected(page)),
            section("kept", "Kept photos", gallery::kept(page)),
            section("review", "How firm the verdicts are", review::body(page)),
        ]);
    }
    if page.with_document::<Scenes>().next().is_some() {
        sections.insert(0, section("scenes", "Scenes", scenes::body(page)));
    }
    if page.with_document::<Ties>().next().is_some() {
        let after_scenes = sections.iter().position(|one| one.id == "graph").unwrap_or(0);
        sections.insert(
            after_scenes,
            section("ties", "How scenes lie to each other", ties::body(page)),
        );
    }
    if filters_alone(page.input) {
        return sections;
    }
    sections.extend([
        section(
            "cameras",
            "Cameras",
            html! { (hardware::body(page)) (cameras::body(page)) },
        ),
        section("tune", "Tuning", tune::body(page)),
        section("training", "Training", curves::body(page)),
        section("heldout", "Held-out photos", pictures::held_out(page)),
        section("uncertainty", "Uncertainty", maps::body(page)),
        section("flight", "Fly-through", pictures::flights(page)),
    ]);
    if ground::is_compared(page) {
        sections.push(section(
            "ground",
            "What changed on the ground",
            ground::body(page),
        ));
    }
    let trade = page.input.trade.as_ref().map(trade::body);
    sections.extend(trade.map(|body| section("trade", "Time against quality", body)));
    sections
}

/// Tells whether the nodes shown only find, filter and split photos, so that there is no scene to show.
fn filters_alone(input: &ReportInput<'_>) -> bool {
    let stages = marf_stages::stages();
    let judges = |node: &NodeView| {
        let def = stages.iter().find(|def| def.name == node.stage);
        let judges = def.is_some_and(|def| def.outputs.contains(&marf_stage::VERDICTS));
        judges || node.stage == ScenesParams::STAGE
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
            (nodes::of_earlier_run(input))
            nav aria-label="Contents" {
                @if let Some(whole) = &input.whole { a href=(whole) { "All scenes" } " " }
                @for section in sections { a href={ "#" (section.id) } { (section.title) } " " }
            }
        }
    }
}
