//! Maps of uncertainty, a row for each viewpoint, and how far they can be trusted.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_model::RunNode;
use marf_schema::bootstrap::{Calibration, HeldOut, Metrics, Mode, ViewReport};
use marf_schema::output;
use maud::{Markup, html};

use super::axis::{Chart, Scale};
use super::embed::Form;
use super::format::{count, decibels, number};
use super::json;
use super::page::Page;
use super::quality::{figures, of_bootstrap, rounded};

/// Most viewpoints of one node.
const MOST_VIEWS: usize = 8;

/// Kinds of maps in the order in which they are shown: ending, heading.
const KINDS: [(&str, &str); 12] = [
    ("photo", "photo"),
    ("mean", "mean of the members"),
    ("error", "|mean - photo|"),
    ("std", "standard deviation"),
    ("residual", "error where photos trained on show it"),
    ("total", "total deviation"),
    ("interval", "90 % interval, gray levels"),
    ("unseen", "what no photo saw"),
    ("coverage", "photos that saw it"),
    ("depth-std", "depth, standard deviation"),
    ("depth-interval", "depth, 90 % interval"),
    ("rgb-std", "standard deviation, each channel"),
];

/// What is true of the scales of all maps.
const SCALES: &str = "Maps of one kind share a scale. It ends at a round number that most of the pixels that photos saw do not exceed. \
    Pixels above it have the colour of the end, and its label begins with >=. Gray pixels have no value.";

/// Maps of every node that has some.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let nodes: Vec<&RunNode> = page.with_outputs_under(output::MAPS).collect();
    if nodes.is_empty() {
        return page.absent("maps of uncertainty");
    }
    html! { @for node in nodes { h3 { (node.run.name) } (of_node(page, node)) } }
}

/// Returns the uncertainty map of a view, with its heading. The node that made it reads the training or a
/// node upstream of it. `None` without such a node, or if it has no map of this view.
pub(super) fn uncertainty_of<'p>(
    page: &Page<'p>,
    training: &RunNode,
    view: &str,
) -> Option<(&'static str, &'p Digest)> {
    let of_training = page.report.upstream(training);
    let is_of = |node: &&RunNode| {
        let names = page.report.upstream(node);
        names
            .iter()
            .any(|name| *name == training.run.name || of_training.contains(name))
    };
    let map = |node: &'p RunNode, kind: &str| node.digest(&format!("{}{view}-{kind}.png", output::MAPS));
    let mut nodes = page.with_outputs_under(output::MAPS).filter(is_of);
    nodes.find_map(|node| {
        let kinds = KINDS.iter().filter(|(kind, _)| matches!(*kind, "total" | "std"));
        kinds
            .rev()
            .find_map(|(kind, heading)| Some((*heading, map(node, kind)?)))
    })
}

fn of_node(page: &Page<'_>, node: &RunNode) -> Markup {
    let pictures = by_view(node);
    let metrics = page.document::<Metrics>(node);
    let views = metrics.as_ref().map_or(&[][..], |metrics| &metrics.views);
    let view = |name: &str| views.iter().find(|view| view.name == name);
    html! {
        @match &metrics {
            Ok(metrics) => (reliability(metrics)),
            Err(missing) => (missing),
        }
        @if !pictures.is_empty() { p.quiet { (SCALES) } }
        @for (name, maps) in pictures.iter().take(MOST_VIEWS) { (row(page, name, maps, view(name))) }
        @if pictures.len() > MOST_VIEWS {
            p.quiet { (count(pictures.len() - MOST_VIEWS, "viewpoint")) " not shown." }
        }
    }
}

/// Shows how well the deviation predicts the error.
fn reliability(metrics: &Metrics) -> Markup {
    let alone = Metrics {
        views: Vec::new(), // they stand beside the maps
        ..metrics.clone()
    };
    html! {
        (figures(&of_bootstrap(metrics)))
        p {
            "The members are trainings on the same photos, each with a seed"
            @if metrics.mode == Mode::Photos { " and a draw of the photos" }
            " of its own. Where they differ, the field is not sure. The total deviation adds their errors at photos trained on, and all of \
             the range where no photo saw anything."
        }
        table.facts {
            @for (name, value) in spread(metrics) { tr { th scope="row" { (name) } td.number { (value) } } }
        }
        @if metrics.heldout.as_ref().is_some_and(|held_out| held_out.coverage.sd1 < held_out.coverage_nominal.sd1) {
            p.quiet { "Too few errors are within the deviation of the members: it does not show what all of them get wrong. \
                Where there are 90 % intervals, they are fitted to the errors at held-out photos." }
        }
        @if let Some(held_out) = &metrics.heldout { (intervals(held_out)) (curves(held_out)) }
        (members(metrics))
        (json::folded("all metrics", &alone))
    }
}

/// Shows how well photos agree with the members that did not draw them.
fn members(metrics: &Metrics) -> Markup {
    let in_bag = |psnr: Option<f64>| psnr.map(|psnr| format!(", {} dB where they did", decibels(psnr)));
    html! {
        @if let Some(out) = &metrics.out_of_bag {
            p {
                (count(out.photos as usize, "photo")) " that some members did not draw: PSNR of these members "
                (decibels(out.psnr)) " dB" (in_bag(out.psnr_in_bag).unwrap_or_default()) "."
            }
        }
    }
}

/// Shows the 90 % intervals and how far they hold at places they were not fitted on, of gray and of the depth side by side.
fn intervals(held_out: &HeldOut) -> Markup {
    let gray = |value: f64| format!("{} of 255 levels", rounded(255.0 * value));
    let depth = |share: f64| format!("{} % of it", rounded(100.0 * share));
    let columns: Vec<IntervalColumn> = [
        held_out
            .calibration
            .as_ref()
            .map(|one| IntervalColumn::new("gray", one, &gray)),
        held_out
            .depth_calibration
            .as_ref()
            .map(|one| IntervalColumn::new("depth", one, &depth)),
    ]
    .into_iter()
    .flatten()
    .collect();
    html! {
        @if held_out.calibration.is_none() { p { "No interval: it takes photos of two places that are held out." } }
        @if held_out.depth_calibration.is_none() {
            p { "No interval of the depth: it takes 100 sparse points in photos of two places that are held out." }
        }
        @if !columns.is_empty() {
            table.facts {
                thead { tr { th {} @for column in &columns { th scope="col" { (column.head) } } } }
                tbody {
                    @for (row, name) in IntervalColumn::ROWS.iter().enumerate() {
                        tr { th scope="row" { (name) } @for column in &columns { td.number { (column.values[row]) } } }
                    }
                }
            }
        }
        @for column in columns.iter().filter(|column| !column.note.is_empty()) {
            p.quiet { "Note on the interval of " (column.head) ": " (column.note) "." }
        }
    }
}

/// The 90 % intervals of one quantity.
struct IntervalColumn<'a> {
    head: &'static str,
    values: [String; 8],
    note: &'a str,
}

impl<'a> IntervalColumn<'a> {
    const ROWS: [&'static str; 8] = [
        "half of the 90 % interval at the median pixel",
        "it is the spread of the members times",
        "with a spread of at least",
        "half of the errors are at most",
        "errors inside at places it was not fitted on, mean (range)",
        "stated and found shares differ in the mean by",
        "pixels without an interval: no photo saw what they show",
        "compared",
    ];

    fn new(head: &'static str, calibration: &'a Calibration, in_unit: &dyn Fn(f64) -> String) -> Self {
        let percent = |share: f64| format!("{} %", number(share * 100.0));
        let [low, high] = calibration.coverage90_range.map(percent);
        Self {
            head,
            values: [
                format!("± {}", in_unit(calibration.median_half90)),
                number(calibration.factor90),
                in_unit(calibration.floor),
                in_unit(calibration.median_error),
                format!("{} ({low} to {high})", percent(calibration.coverage90)),
                percent(calibration.ece),
                percent(calibration.unseen_share),
                format!(
                    "{}, {}",
                    count(calibration.errors as usize, "pixel"),
                    count(calibration.places as usize, "place")
                ),
            ],
            note: &calibration.note,
        }
    }
}

/// Curves of the remaining error without the most uncertain pixels, and of the share of errors inside the
/// stated intervals.
fn curves(held_out: &HeldOut) -> Markup {
    let curves = &held_out.sparsification;
    let line = |values: &[f64]| -> Vec<(f64, f64)> {
        let levels = values.iter().map(|value| value * 255.0);
        curves
            .removed
            .iter()
            .map(|share| share * 100.0)
            .zip(levels)
            .collect()
    };
    let everything = curves.by_std.first().copied().unwrap_or(0.0);
    let sparsification = Chart {
        title: "Mean error without the most uncertain pixels",
        x_label: "most uncertain pixels taken away, %",
        y_label: "mean absolute error, gray levels",
        scale: Scale::Linear,
        lines: vec![
            ("by standard deviation", line(&curves.by_std)),
            ("by total deviation", line(&curves.by_total)),
            ("best order", line(&curves.best)),
            ("random order", line(&vec![everything; curves.removed.len()])),
        ],
    };
    let inside = |calibration: Option<&Calibration>| -> Vec<(f64, f64)> {
        let shares = calibration.map_or(&[][..], |calibration| &calibration.inside);
        let stated = (1..=shares.len()).map(|twentieth| twentieth as f64 * 5.0);
        stated.zip(shares.iter().map(|share| share * 100.0)).collect()
    };
    let reliability = Chart {
        title: "Errors inside intervals, at places they were not fitted on",
        x_label: "stated share, %",
        y_label: "errors inside, %",
        scale: Scale::Linear,
        lines: vec![
            ("gray levels", inside(held_out.calibration.as_ref())),
            ("depth", inside(held_out.depth_calibration.as_ref())),
            ("as stated", vec![(0.0, 0.0), (100.0, 100.0)]),
        ],
    };
    html! {
        div.charts {
            (sparsification.drawn())
            @if held_out.calibration.is_some() { (reliability.drawn()) }
        }
        p.quiet {
            "These are mean absolute errors of gray. The error on the first screen is a root mean square, in which large errors count more."
        }
    }
}

/// Returns a number with at most one decimal.
fn tenths(value: f64) -> String {
    number((10.0 * value).round() / 10.0)
}

/// Name and value of each measure of the spread.
fn spread(metrics: &Metrics) -> Vec<(&'static str, String)> {
    let levels = |value: f64| format!("{} gray levels", tenths(255.0 * value));
    let percent = |share: f64| format!("{} %", tenths(100.0 * share));
    let mut found = vec![
        ("mean standard deviation", levels(metrics.std)),
        ("mean total deviation", levels(metrics.total_sd)),
        ("pixels that no photo saw", percent(metrics.unseen_share)),
        ("pixels of sky that photos saw", percent(metrics.sky_share)),
    ];
    let Some(held_out) = &metrics.heldout else {
        return found;
    };
    let (mean, coverage) = (&held_out.mean, &held_out.coverage);
    let in_db = |psnr: f64| format!("{} dB", decibels(psnr));
    found.extend([
        ("PSNR of the members' mean", in_db(mean.psnr)),
        ("PSNR of one member, mean", in_db(held_out.psnr_members_mean)),
        (
            "error of the order by standard deviation (AUSE, 0 is best)",
            number(mean.ause_mae),
        ),
        (
            "error of the order by total deviation",
            number(mean.ause_mae_total),
        ),
        ("error of a random order", number(mean.ause_mae_random)),
        ("rank correlation of deviation and error", number(mean.spearman)),
        (
            "errors within 1 deviation (68 % if normal)",
            percent(coverage.sd1),
        ),
        (
            "errors within 2 deviations (95 % if normal)",
            percent(coverage.sd2),
        ),
    ]);
    found
}

fn row(
    page: &Page<'_>,
    name: &str,
    maps: &BTreeMap<usize, (&str, &Digest)>,
    metrics: Option<&ViewReport>,
) -> Markup {
    html! {
        div.view {
            h4 {
                span.file { (name) }
                @if let Some(view) = metrics {
                    span.quiet { "mean standard deviation " (tenths(255.0 * view.std)) " gray levels" }
                }
            }
            div.row.maps {
                @for (kind, digest) in maps.values() {
                    figure {
                        (page.pictures.stored(page.report, digest, form(kind), &format!("{kind} at {name}")))
                        figcaption { (heading(kind)) }
                    }
                }
            }
        }
    }
}

/// Colours of a map carry numbers and stay exact. Photos may be JPEG.
fn form(kind: &str) -> Form {
    match kind {
        "photo" => Form::Panel("photo"),
        "mean" => Form::Panel("mean of the members"),
        _ => Form::Map,
    }
}

fn heading(kind: &str) -> &str {
    KINDS
        .iter()
        .find(|(ending, _)| *ending == kind)
        .map_or(kind, |(_, heading)| heading)
}

/// View to (column to (kind, picture)). Unknown endings come last.
fn by_view(node: &RunNode) -> BTreeMap<&str, BTreeMap<usize, (&str, &Digest)>> {
    let mut views: BTreeMap<&str, BTreeMap<usize, (&str, &Digest)>> = BTreeMap::new();
    for (name, digest) in node.outputs_under(output::MAPS) {
        let Some((view, column, kind)) = name.strip_suffix(".png").and_then(split) else {
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
        assert_eq!(split("rock-3-depth-std"), Some(("rock-3", 9, "depth-std")));
        assert_eq!(split("rock-3-std"), Some(("rock-3", 3, "std")));
        assert_eq!(split("a-b-new"), Some(("a-b", 12, "new")));
        assert_eq!(split("plain"), None);
    }
}
