//! Maps of uncertainty, a row for each viewpoint, and how far they can be trusted.

use std::collections::BTreeMap;

use marf_cache::Digest;
use maud::{Markup, html};
use serde_json::Value;

use super::embed::Form;
use super::format::{count, number};
use super::input::NodeView;
use super::json;
use super::page::Page;
use super::quality::{figures, view, without_views};

/// Most viewpoints of one node.
const MOST_VIEWS: usize = 8;

/// Kinds of maps in the order in which they are shown: ending, heading.
const KINDS: [(&str, &str); 8] = [
    ("photo", "photo"),
    ("mean", "mean of the members"),
    ("error", "|mean - photo|"),
    ("std", "standard deviation"),
    ("total", "total deviation"),
    ("opacity", "opacity term"),
    ("depth-std", "depth, standard deviation"),
    ("rgb-std", "standard deviation, each channel"),
];

/// Figures of the maps: path in the metrics, name.
const FIGURES: [(&str, &str); 14] = [
    ("std", "mean standard deviation"),
    ("total_sd", "mean total deviation"),
    ("opacity_term", "mean opacity term"),
    ("unseen_share", "share of unseen pixels"),
    ("heldout.psnr", "PSNR of the mean, dB"),
    ("heldout.psnr_members_mean", "PSNR of one member, dB, mean"),
    ("heldout.ause_mae", "AUSE by standard deviation (0 is best)"),
    ("heldout.ause_mae_total", "AUSE by total deviation"),
    ("heldout.ause_mae_random", "AUSE of a random order"),
    ("heldout.spearman", "rank correlation of deviation and error"),
    (
        "heldout.coverage.sd1",
        "errors within 1 deviation (68 % if normal)",
    ),
    (
        "heldout.coverage.sd2",
        "errors within 2 deviations (95 % if normal)",
    ),
    ("heldout.calibration.ece", "calibration error after scaling"),
    ("heldout.calibration.coverage90", "cover of the 90 % interval"),
];

/// Maps of every node that has some.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let nodes: Vec<&NodeView> = page.with_outputs_under("maps/").collect();
    if nodes.is_empty() {
        return page.absent("maps of uncertainty");
    }
    html! { @for node in nodes { h3 { (node.name) } (of_node(page, node)) } }
}

fn of_node(page: &Page<'_>, node: &NodeView) -> Markup {
    let views = by_view(node);
    let metrics = page.json::<Value>(node, "metrics");
    let known = metrics.as_ref().ok();
    html! {
        @match &metrics {
            Ok(metrics) => (trust(metrics)),
            Err(missing) => (missing),
        }
        @for (name, maps) in views.iter().take(MOST_VIEWS) {
            (row(page, name, maps, known.and_then(|metrics| view(metrics, name))))
        }
        @if views.len() > MOST_VIEWS { p.quiet { (count(views.len() - MOST_VIEWS, "viewpoint")) " not shown." } }
    }
}

/// The figures that say whether high deviation goes with large error.
fn trust(metrics: &Value) -> Markup {
    let at = |path: &str| {
        metrics
            .pointer(&format!("/{}", path.replace('.', "/")))
            .and_then(Value::as_f64)
    };
    html! {
        (figures(metrics))
        table.facts {
            @for (path, name) in FIGURES { @if let Some(value) = at(path) {
                tr { th scope="row" { (name) } td.number { (number(value)) } }
            } }
        }
        details { summary { "all metrics" } (json::tables(&without_views(metrics))) }
    }
}

fn row(
    page: &Page<'_>,
    name: &str,
    maps: &BTreeMap<usize, (&str, &Digest)>,
    metrics: Option<&Value>,
) -> Markup {
    html! {
        div.view {
            h4 {
                span.file { (name) }
                @if let Some(std) = metrics.and_then(|view| view.get("std")?.as_f64()) {
                    span.quiet { "mean standard deviation " (number(std)) }
                }
            }
            div.row.maps {
                @for (kind, digest) in maps.values() {
                    figure {
                        (page.pictures.stored(page.input, digest, form(kind), &format!("{kind} at {name}")))
                        figcaption { (heading(kind)) }
                    }
                }
            }
        }
    }
}

/// Colours of a map carry numbers and stay exact; photos may be JPEG.
fn form(kind: &str) -> Form {
    if matches!(kind, "photo" | "mean") {
        Form::Photo
    } else {
        Form::Map
    }
}

fn heading(kind: &str) -> &str {
    KINDS
        .iter()
        .find(|(ending, _)| *ending == kind)
        .map_or(kind, |(_, heading)| heading)
}

/// View to (column to (kind, picture)); endings that are not known come last.
fn by_view(node: &NodeView) -> BTreeMap<&str, BTreeMap<usize, (&str, &Digest)>> {
    let mut views: BTreeMap<&str, BTreeMap<usize, (&str, &Digest)>> = BTreeMap::new();
    for (output, digest) in &node.outputs {
        let picture = output
            .strip_prefix("maps/")
            .and_then(|name| name.strip_suffix(".png"));
        let Some((view, column, kind)) = picture.and_then(split) else {
            continue;
        };
        let maps = views.entry(view).or_default();
        let free = (column..)
            .find(|column| !maps.contains_key(column))
            .unwrap_or(column);
        maps.insert(free, (kind, digest));
    }
    views
}

/// `rock-3-depth-std` is `depth-std` of `rock-3`: of two endings that fit the longer one holds.
fn split(picture: &str) -> Option<(&str, usize, &str)> {
    let fits = |(column, (ending, _)): (usize, &(&'static str, &str))| {
        let view = picture.strip_suffix(ending)?.strip_suffix('-')?;
        Some((view, column, *ending))
    };
    let known = KINDS.iter().enumerate().filter_map(fits);
    let known = known.max_by_key(|(_, _, ending)| ending.len());
    known.or_else(|| {
        picture
            .rsplit_once('-')
            .map(|(view, kind)| (view, KINDS.len(), kind))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_split_at_its_longest_ending() {
        assert_eq!(split("rock-3-depth-std"), Some(("rock-3", 6, "depth-std")));
        assert_eq!(split("rock-3-std"), Some(("rock-3", 3, "std")));
        assert_eq!(split("a-b-new"), Some(("a-b", 8, "new")));
        assert_eq!(split("plain"), None);
    }
}
