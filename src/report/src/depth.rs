//! Depths of the photos without a field.

use marf_model::RunNode;
use marf_schema::depth::Metrics;
use marf_schema::output::{DEPTH_PREVIEW, SURFACE_MAPS};
use maud::{Markup, html};

use super::agreement;
use super::embed::Form;
use super::page::Page;

/// Returns true if a run has depths.
pub(super) fn is_made(page: &Page<'_>) -> bool {
    page.with_document::<Metrics>().next().is_some()
}

/// One picture and one sentence for every node.
pub(super) fn body(page: &Page<'_>) -> Markup {
    html! { @for node in page.with_document::<Metrics>() { (of_node(page, node)) } }
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn of_node(page: &Page<'_>, node: &RunNode) -> Markup {
    let metrics = match page.document::<Metrics>(node) {
        Ok(metrics) => metrics,
        Err(missing) => return html! { (missing) },
    };
    let fullest = metrics.photos.iter().max_by(|a, b| a.share.total_cmp(&b.share));
    let map = format!("{SURFACE_MAPS}orthophoto.png");
    let preview = fullest.map(|photo| format!("{DEPTH_PREVIEW}{}.png", photo.name));
    let digests = [
        (Some(map), "Orthophoto"),
        (preview, "Depths of the photo with most, near ones bright"),
    ];
    let shown = digests
        .into_iter()
        .find_map(|(name, title)| Some((node.digest(&name?)?, title)));
    html! {
        p {
            (node.run.name) ": pairs of photos give " strong { (percent(metrics.share)) } " of the pixels a depth, two pairs confirm "
            (percent(metrics.confirmed_share)) " of all"
            @if let Some(sigma) = metrics.median_sigma_share {
                ", and one standard deviation is " (percent(sigma)) " of the distance in the median"
            }
            "."
            @if metrics.sky_share > 0.0 { " " (percent(metrics.sky_share)) " of the pixels show sky, which has none." }
        }
        @if metrics.unit == "metres" { (agreement::body(page, node)) }
        @if let Some((digest, title)) = shown {
            figure { (page.pictures.stored(page.report, digest, Form::Map, title)) figcaption { (title) } }
        }
    }
}
