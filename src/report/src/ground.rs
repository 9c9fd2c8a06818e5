//! One place at two times: what changed on the ground.

use marf_model::RunNode;
use marf_schema::changes::{ChangesReport, Patch, Time};
use marf_schema::output::CHANGE_MAPS;
use maud::{Markup, html};

use super::embed::Form;
use super::format::{count, decibels, number};
use super::page::{Page, key};

/// Most patches in the table.
const MOST_PATCHES: usize = 30;
/// The maps, with what they show.
const MAPS: [(&str, &str); 3] = [("map", "What changed"), ("before", "Before"), ("after", "After")];

/// Returns true if a run has compared two times.
pub(super) fn is_compared(page: &Page<'_>) -> bool {
    page.with_document::<ChangesReport>().next().is_some()
}

/// Maps and patches of every comparison.
pub(super) fn body(page: &Page<'_>) -> Markup {
    html! { @for node in page.with_document::<ChangesReport>() { h3 { (node.run.name) } (of_node(page, node)) } }
}

fn of_node(page: &Page<'_>, node: &RunNode) -> Markup {
    let report = match page.document::<ChangesReport>(node) {
        Ok(report) => report,
        Err(missing) => return html! { (missing) },
    };
    html! {
        p {
            "Before: " (time(&report.before)) ". After: " (time(&report.after)) ". Both show " (number(report.compared_m2)) " m²: "
            strong { (number(report.changed_m2)) " m² changed" } ", " (number(report.undecided_m2)) " m² undecided."
        }
        p.quiet {
            "Where nothing changed, 90 % of the cells (" (number(report.cell_m)) " m) differ by less than "
            (number(report.height.interval)) " m. The two times lie " (number(report.registration.offset_m))
            " m apart in height as a whole, which is taken away, as is how bright and of which colour the light is. \
             Light and ground cannot be told apart where brightness alone differs: a shadow does the same."
        }
        div.charts {
            @for (name, title) in MAPS {
                @if let Some(map) = node.digest(&format!("{CHANGE_MAPS}{name}.png")) {
                    figure { (page.pictures.stored(page.report, map, Form::Map, title)) figcaption { (title) } }
                }
            }
        }
        p.legend {
            (key("higher", "higher")) (key("lower", "lower")) (key("colour", "another colour")) (key("undecided", "undecided"))
            span { "dark: one time alone, black: not seen" }
        }
        @if report.patches.is_empty() { p { "No patch is larger than the noise." } } @else { (table(&report.patches)) }
    }
}

fn time(time: &Time) -> String {
    let sols: Vec<String> = time.sols.iter().map(u32::to_string).collect();
    let photos = count(time.photos, "photo");
    format!(
        "{photos} of sols {}, PSNR {} dB",
        sols.join(", "),
        decibels(time.psnr)
    )
}

fn table(patches: &[Patch]) -> Markup {
    html! {
        div.scroll {
            table {
                thead { tr {
                    th { "Change" } th.number { "Area, m²" } th.number { "from, to" } th.number { "Right, up of the origin, m" }
                    th.number { "Height, m" } th.number { "90 %" } th.number { "Volume, m³" } th.number { "Light" }
                } }
                tbody { @for patch in patches.iter().take(MOST_PATCHES) { (row(patch)) } }
            }
        }
        @if patches.len() > MOST_PATCHES { p.quiet { (patches.len() - MOST_PATCHES) " smaller patches are in the files." } }
    }
}

fn row(patch: &Patch) -> Markup {
    let [least, most] = patch.area_interval_m2;
    let [height_m, interval_m] = patch.height_m;
    html! {
        tr {
            td { (patch.change.word()) }
            td.number { (number(patch.area_m2)) }
            td.number { (number(least)) ", " (number(most)) }
            td.number { (number(patch.middle_m[0])) ", " (number(patch.middle_m[1])) }
            td.number { (number(height_m)) }
            td.number { "± " (number(interval_m)) }
            td.number { (number(patch.volume_m3)) }
            td.number { "× " (number(patch.brightness)) }
        }
    }
}
