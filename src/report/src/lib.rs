//! report.html: what ran, what was kept, how good it is.
//!
//! One file, complete in itself: pictures as data URIs, charts as inline SVG, no script, no request to
//! anywhere. Or a page that is served (`linked`): pictures, films and style are files under their digests.
//! Invariants: no text of the outside (file names, labels, reasons) reaches the page unescaped. A sentence
//! replaces an output that is absent or unreadable.

mod agreement;
mod axis;
mod call;
mod camera_view;
mod cameras;
mod changes;
mod curves;
mod depth;
mod embed;
pub mod emptied;
mod funnel;
mod gallery;
mod graph;
mod ground;
mod hardware;
mod json;
mod lead;
mod maps;
mod media;
mod nodes;
mod notes;
mod page;
mod photos;
mod pictures;
mod quality;
mod read;
mod report;
mod review;
mod scenes;
mod sets;
mod sizes;
mod thumbs;
mod ties;
pub mod trade;
pub mod trade_page;
mod tune;
mod unplaced;
mod vector;
mod verdicts;
mod visible;

#[cfg(test)]
mod draft_tests;
#[cfg(test)]
mod failed;
#[cfg(test)]
mod fixture;
#[cfg(test)]
mod fixture_documents;
#[cfg(test)]
mod real;
#[cfg(test)]
mod sentence_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod twice;

use marf_model::RunNode;
use marf_progress::format;
use marf_schema::scenes::{Scenes, ScenesParams};
use marf_schema::ties::Ties;
use marf_stage::{Params, VERDICTS};
use maud::{DOCTYPE, Markup, PreEscaped, html};

use media::Media;
use page::Page;
use report::stage;
use sets::Set;
use verdicts::Summary;

pub use call::{Call, FACTORS, calls};
pub use media::{EmbeddedView, File, LinkedPage, LiveParts};
pub use quality::Figure;
pub use report::{ChangedNode, Changes, ReadBlob, Report, ScenePage};
pub use review::percent;
pub use visible::{visible, visible_document};

/// The way from the page of a scene to that of all, on disk and where it is served.
const ALL_SCENES: [&str; 2] = ["../report.html", "../"];

/// Writes the report as one HTML file. The same report gives the same bytes, and nothing in it can make it
/// panic.
pub fn write(report: &Report<'_>) -> String {
    page_of(report, &Media::Embedded)
}

/// Writes the report as one HTML file with a 3-D view.
pub fn write_with_view(report: &Report<'_>, view: &EmbeddedView) -> String {
    page_of(report, &Media::WithView(view))
}

/// Returns one line for each camera whose photos a filter keeps as photos of another kind, such as monochrome ones.
pub fn kept_as(report: &Report<'_>) -> Vec<String> {
    let verdicts = report
        .nodes
        .iter()
        .filter_map(|node| Set::open(report, node, VERDICTS)?.ok());
    let sums = verdicts.filter_map(|set| Summary::new(report, &set).ok());
    sums.flat_map(|sum| sum.kept_as_lines().collect::<Vec<_>>())
        .collect()
}

/// Returns the figures of the first screen: photos kept and placed, error and unseen share of new views, extent.
pub fn summary(report: &Report<'_>) -> Vec<Figure> {
    lead::figures_of(&Page::new(report, &Media::Embedded))
}

/// Writes the report as a page that is served: style, pictures and films have addresses of their own, and live parts are added.
pub fn linked(report: &Report<'_>, live: &LiveParts) -> LinkedPage {
    let media = Media::linked(live);
    let page = page_of(report, &media);
    media.with_files(page)
}

/// Writes a page of one sentence in the form of a linked report: while there is none.
pub fn sentence_page(sentence: &str, live: &LiveParts) -> LinkedPage {
    let media = Media::linked(live);
    let body = html! {
        header { h1 { "marf" } p.lead { (sentence) } nav aria-label="Contents" { (live.navigation) } }
        main { (live.main) }
    };
    let page = document("marf", &body, &media);
    media.with_files(page)
}

fn page_of(report: &Report<'_>, media: &Media<'_>) -> String {
    let page = Page::new(report, media);
    // First, since a film is shown once.
    let lead = lead::body(&page);
    let sections = sections(&page);
    let title = format!("{}, marf report", report.title());
    let body = html! {
        (header(&page, &lead, &sections, media))
        main {
            @if let Some(live) = media.live() { (live.main) }
            @if let Some(view) = media.view() { (view.main) }
            @for section in &sections { (section.shown()) }
        }
        footer { (report.run.record.program) ", run started " (report.started) "." }
    };
    document(&title, &body, media)
}

fn document(title: &str, body: &Markup, media: &Media<'_>) -> String {
    const STYLE: &str = include_str!("style.css");
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                @if media.live().is_none() { meta http-equiv="Content-Security-Policy" content=(policy(media)); }
                meta name="viewport" content="width=device-width";
                title { (title) }
                @match media.live() {
                    None => style { (PreEscaped(STYLE)) },
                    Some(live) => {
                        link rel="stylesheet" href=(media.made("text/css; charset=utf-8", STYLE.as_bytes()));
                        (live.head)
                    }
                }
            }
            body { (body) }
        }
    };
    visible_document(&page.into_string(), |char| {
        visible(char.encode_utf8(&mut [0; 4])).into_owned()
    })
    .into_owned()
}

/// Returns the content security policy of a page in one file: nothing is loaded, and no script runs but that of its 3-D view.
fn policy(media: &Media<'_>) -> String {
    let scripts = media.view().map(|view| {
        let nonce = &view.nonce;
        format!("; script-src 'nonce-{nonce}'; worker-src blob:")
    });
    let scripts = scripts.unwrap_or_default();
    format!("default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'{scripts}")
}

/// A part of the page that the contents list leads to.
struct Section {
    id: &'static str,
    title: &'static str,
    body: Markup,
    is_folded: bool,
}

impl Section {
    fn open(id: &'static str, title: &'static str, body: Markup) -> Self {
        Self {
            id,
            title,
            body,
            is_folded: false,
        }
    }

    fn folded(id: &'static str, title: &'static str, body: Markup) -> Self {
        Self {
            is_folded: true,
            ..Self::open(id, title, body)
        }
    }

    fn shown(&self) -> Markup {
        html! {
            section id=(self.id) {
                @if self.is_folded { details { summary { h2 { (self.title) } } (self.body) } }
                @else { h2 { (self.title) } (self.body) }
            }
        }
    }
}

/// Returns the sections: results first, then what they were made from, then the work.
fn sections(page: &Page<'_>) -> Vec<Section> {
    let mut sections = Vec::new();
    if page.with_document::<Scenes>().next().is_some() {
        sections.push(Section::open("scenes", "Scenes", scenes::body(page)));
    }
    if page.with_document::<Ties>().next().is_some() {
        sections.push(Section::open(
            "ties",
            "How scenes lie to each other",
            ties::body(page),
        ));
    }
    if !filters_alone(page.report) {
        sections.extend(field_sections(page));
    }
    if page.report.scene.is_none() {
        sections.extend([
            Section::open("funnel", "Filters", funnel::body(page)),
            Section::open("rejected", "Rejected photos", gallery::rejected(page)),
            Section::folded("kept", "Kept photos", gallery::kept(page)),
            Section::folded("review", "How firm the verdicts are", review::body(page)),
        ]);
    }
    if !filters_alone(page.report) {
        let trade = page.report.trade.as_ref().map(trade_page::body);
        sections.extend(trade.map(|body| Section::open("trade", "Time against quality", body)));
        sections.extend([
            Section::folded("training", "Training", curves::body(page)),
            Section::folded("tune", "Tuning", tune::body(page)),
        ]);
    }
    sections.extend([
        Section::open("graph", "Pipeline", graph::body(page)),
        Section::folded("nodes", "Nodes", nodes::body(page)),
        Section::open("changes", "What changed", changes::body(page)),
    ]);
    sections
}

/// Returns the sections on the field and its cameras.
fn field_sections(page: &Page<'_>) -> Vec<Section> {
    let mut sections = vec![
        Section::open("heldout", "Held-out photos", pictures::held_out(page)),
        Section::open("uncertainty", "Uncertainty", maps::body(page)),
        Section::open("flight", "Fly-through", pictures::flights(page)),
    ];
    if ground::is_compared(page) {
        sections.push(Section::open(
            "ground",
            "What changed on the ground",
            ground::body(page),
        ));
    }
    if depth::is_made(page) {
        sections.push(Section::open(
            "depth",
            "Depths without a field",
            depth::body(page),
        ));
    }
    let cameras = html! { (hardware::body(page)) (cameras::body(page)) };
    sections.push(Section::open("cameras", "Cameras", cameras));
    sections
}

/// Returns true if the shown nodes only find, filter and split photos, so that there is no scene to show.
fn filters_alone(report: &Report<'_>) -> bool {
    let judges = |node: &&RunNode| {
        let judges = stage(node).is_some_and(|def| def.outputs.contains(&marf_stage::VERDICTS));
        judges || node.run.stage == ScenesParams::STAGE
    };
    !report.nodes.is_empty() && report.nodes.iter().all(judges)
}

fn header(page: &Page<'_>, lead: &Markup, sections: &[Section], media: &Media<'_>) -> Markup {
    let [on_disk, served] = ALL_SCENES;
    let report = page.report;
    let record = &report.run.record;
    html! {
        header {
            h1 { (report.title()) }
            (lead)
            p.quiet.work { (nodes::sentence(report)) ". " code { (record.command) } ", started " (report.started) ", " (record.program) }
            nav aria-label="Contents" {
                @if let Some(live) = media.live() { (live.navigation) }
                @if media.view().is_some() { a href="#view" { "3-D view" } " " }
                @if report.scene.is_some() {
                    a href=(media.live().map_or(on_disk, |_| served)) { "All scenes" } " "
                }
                @for section in sections { a href={ "#" (section.id) } { (section.title) } " " }
            }
        }
    }
}
