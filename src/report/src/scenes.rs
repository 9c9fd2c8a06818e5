//! The scenes of a mission: where they are, how each fared, and the groups that are not scenes.

use std::collections::BTreeMap;

use marf_model::RunNode;
use marf_schema::scenes::{PhotoGroup, Scenes, Stop};
use marf_schema::{calibrate, train};
use marf_stage::Document;
use maud::{Markup, html};

use super::axis::round_step;
use super::format::{count, decibels, number, px};
use super::page::{Page, key};
use super::report::{FAILED, STATES, ScenePage, state, state_of_all};

const WIDTH: f64 = 640.0;
/// A map is at most and at least so high.
const HEIGHT: f64 = 480.0;
const LEAST_HEIGHT: f64 = 200.0;
const MARGIN: f64 = 64.0;
/// Least extent of a map, metres: one stop alone is a dot in it.
const LEAST_EXTENT_M: f64 = 10.0;
/// Most maps, one a site. The table names the scenes of all.
const MOST_MAPS: usize = 12;
/// Most groups that are not scenes in the list.
const MOST_LEFT_OUT: usize = 200;

/// The maps, the table of scenes, and the groups that are none.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let read = page
        .with_document::<Scenes>()
        .map(|node| page.document::<Scenes>(node));
    html! {
        @for scenes in read {
            @match scenes {
                Ok(scenes) => (of_split(page, &scenes)),
                Err(missing) => (missing),
            }
        }
    }
}

fn of_split(page: &Page<'_>, scenes: &Scenes) -> Markup {
    let mut sites: BTreeMap<i64, Vec<&Stop>> = BTreeMap::new();
    for stop in &scenes.stops {
        sites.entry(stop.site).or_default().push(stop);
    }
    let views = &page.report.scenes;
    let photos: usize = scenes.scenes.iter().map(|scene| scene.photos.len()).sum();
    html! {
        p {
            (count(scenes.scenes.len(), "scene")) " of " (count(photos, "photo")) "; "
            (count(scenes.skipped.len(), "group")) " left out."
            @if sites.len() > 1 { " Positions of different sites share no frame, so that each site has a map of its own." }
        }
        div.charts {
            @for (site, stops) in sites.iter().take(MOST_MAPS) {
                figure { (map(stops, views)) figcaption { "Site " (site) ": " (count(stops.len(), "stop")) ", a dot each, the larger the more photos" } }
            }
        }
        @if sites.len() > MOST_MAPS { p.quiet { (sites.len() - MOST_MAPS) " other sites have no map here." } }
        @if !sites.is_empty() {
            p.legend {
                @for word in STATES { (key(word, word)) }
                (key("none", "of no scene"))
            }
        }
        div.scroll {
            table {
                thead { tr {
                    th { "Scene" } th { "State" } th.number { "Photos" } th { "Sols" } th.number { "Span, m" }
                    th.number { "Placed" } th.number { "From labels, m" } th.number { "PSNR, dB" } th { "Why" }
                } }
                tbody { @for scene in &scenes.scenes { (row(page, scene, view_of(views, &scene.name))) } }
            }
        }
        (left_out(&scenes.skipped))
    }
}

fn view_of<'v>(views: &'v [ScenePage<'v>], name: &str) -> Option<&'v ScenePage<'v>> {
    views.iter().find(|view| view.name == name)
}

fn row(page: &Page<'_>, scene: &PhotoGroup, view: Option<&ScenePage<'_>>) -> Markup {
    let none: &[&RunNode] = &[];
    let nodes = view.map_or(none, |view| view.nodes.as_slice());
    let document = |stage: &str| {
        nodes
            .iter()
            .rfind(|node| node.run.stage == stage && !node.run.outputs.is_empty())
    };
    let calibrated = document(<calibrate::Metrics as Document>::STAGE)
        .and_then(|node| page.document::<calibrate::Metrics>(node).ok());
    let placed = calibrated
        .as_ref()
        .map(|metrics| metrics.totals.registered.to_string());
    let tie = calibrated.as_ref().and_then(|metrics| metrics.tie);
    let psnr = document(<train::Metrics as Document>::STAGE)
        .and_then(|node| page.document::<train::Metrics>(node).ok())
        .map(|metrics| decibels(metrics.scores.psnr));
    let failed = nodes.iter().find(|node| state(node) == FAILED);
    html! {
        tr {
            td { @match view { Some(view) => a href=(view.page) { (scene.name) }, None => (scene.name) } }
            td { @if let Some(word) = state_of_all(nodes) { span.badge.(word) { (word) } } }
            td.number { (scene.photos.len()) }
            td { (ranges(&scene.sols)) }
            td.number { (scene.span_m.map_or_else(|| "–".to_owned(), number)) }
            td.number { (placed.unwrap_or_else(|| "–".to_owned())) }
            td.number { (tie.map_or_else(|| "–".to_owned(), |tie| number(tie.median_m))) }
            td.number { (psnr.unwrap_or_else(|| "–".to_owned())) }
            td.file {
                (scene.reason)
                @if let Some(failed) = failed { div { strong { (failed.run.name) " failed: " } (failed.run.reason) } }
            }
        }
    }
}

/// Returns numbers as ranges: `1-3, 7`.
fn ranges(numbers: &[u32]) -> String {
    let runs = numbers.chunk_by(|a, b| a + 1 == *b);
    let text = runs.map(|run| match run {
        [one] => one.to_string(),
        [first, .., last] => format!("{first}-{last}"),
        [] => String::new(),
    });
    text.collect::<Vec<_>>().join(", ")
}

fn left_out(skipped: &[PhotoGroup]) -> Markup {
    html! {
        @if !skipped.is_empty() {
            details open[skipped.len() <= 10] {
                summary { (count(skipped.len(), "group")) " left out" }
                div.scroll { table {
                    thead { tr { th { "Group" } th.number { "Photos" } th { "Sols" } th { "Why" } } }
                    tbody {
                        @for group in skipped.iter().take(MOST_LEFT_OUT) {
                            tr {
                                td.file { (group.name) } td.number { (group.photos.len()) } td { (ranges(&group.sols)) } td.file { (group.reason) }
                            }
                        }
                    }
                } }
                @if skipped.len() > MOST_LEFT_OUT { p.quiet { (skipped.len() - MOST_LEFT_OUT) " others are in scenes.json." } }
            }
        }
    }
}

/// Where the stops of one site are in the drawing.
struct Fit {
    /// East and north of the middle, metres.
    middle: [f64; 2],
    px_per_m: f64,
    height: f64,
}

impl Fit {
    fn new(stops: &[&Stop]) -> Self {
        let span = |axis: usize| {
            let values = stops.iter().map(|stop| stop.position_m[axis]);
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), one| {
                (low.min(one), high.max(one))
            });
            ((low + high) / 2.0, (high - low).max(LEAST_EXTENT_M))
        };
        let ((north, tall), (east, wide)) = (span(0), span(1));
        let px_per_m = ((WIDTH - 2.0 * MARGIN) / wide).min((HEIGHT - 2.0 * MARGIN) / tall);
        Self {
            middle: [east, north],
            px_per_m,
            height: (tall * px_per_m + 2.0 * MARGIN).clamp(LEAST_HEIGHT, HEIGHT),
        }
    }

    /// North is up, east to the right.
    fn place(&self, [north, east]: [f64; 2]) -> (f64, f64) {
        let x = WIDTH / 2.0 + (east - self.middle[0]) * self.px_per_m;
        let y = self.height / 2.0 - (north - self.middle[1]) * self.px_per_m;
        (x, y)
    }
}

/// Draws the stops of one site in the order of its drives.
fn map(stops: &[&Stop], views: &[ScenePage<'_>]) -> Markup {
    let fit = Fit::new(stops);
    let places: Vec<(f64, f64)> = stops.iter().map(|stop| fit.place(stop.position_m)).collect();
    let traverse: Vec<String> = places
        .iter()
        .map(|(x, y)| format!("{},{}", px(*x), px(*y)))
        .collect();
    let most = stops.iter().map(|stop| stop.photos).max().unwrap_or(1).max(1);
    let radius = |photos: u64| 4.0 + 8.0 * (photos as f64 / most as f64).sqrt();
    let class = |stop: &Stop| {
        let mut of = stop.scenes.iter().filter_map(|name| view_of(views, name));
        of.find_map(|view| state_of_all(&view.nodes)).unwrap_or("none")
    };
    let mut scenes: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
    for (stop, place) in stops.iter().zip(&places) {
        for scene in &stop.scenes {
            scenes.entry(scene).or_default().push(*place);
        }
    }
    let length_m = round_step(WIDTH / 8.0 / fit.px_per_m);
    let base = fit.height - 14.0;
    html! {
        svg.traverse viewBox={ "0 0 " (px(WIDTH)) " " (px(fit.height)) } width=(px(WIDTH)) height=(px(fit.height))
            role="img" aria-label="Stops of the rover from above, north up" {
            polyline points=(traverse.join(" ")) {}
            @for (name, places) in &scenes {
                @let (x, y, r) = circle(places);
                circle.scene cx=(px(x)) cy=(px(y)) r=(px(r)) {}
                text.name x=(px(x)) y=(px(if y - r > 20.0 { y - r - 5.0 } else { y + r + 15.0 })) text-anchor="middle" { (name) }
            }
            @for (stop, (x, y)) in stops.iter().zip(&places) {
                circle.stop.(class(stop)) cx=(px(*x)) cy=(px(*y)) r=(px(radius(stop.photos))) {
                    title {
                        @if let Some(drive) = stop.drive { "drive " (drive) ", " }
                        (count(usize::try_from(stop.photos).unwrap_or(usize::MAX), "photo"))
                        @if stop.scenes.is_empty() { ", of no scene" } @else { ", " (stop.scenes.join(", ")) }
                    }
                }
            }
            path.bar d={ "M16 " (px(base - 5.0)) "v5h" (px(length_m * fit.px_per_m)) "v-5" } {}
            text x="16" y=(px(base - 10.0)) { (number(length_m)) " m" }
            path.bar d={ "M" (px(WIDTH - 24.0)) " " (px(base)) "v-26m-4 6l4 -6l4 6" } {}
            text x=(px(WIDTH - 24.0)) y=(px(base - 32.0)) text-anchor="middle" { "north" }
        }
    }
}

/// Returns a circle around places: centre and radius, with room for their dots.
fn circle(places: &[(f64, f64)]) -> (f64, f64, f64) {
    let count = places.len().max(1) as f64;
    let x = places.iter().map(|place| place.0).sum::<f64>() / count;
    let y = places.iter().map(|place| place.1).sum::<f64>() / count;
    let farthest = places.iter().map(|place| (place.0 - x).hypot(place.1 - y));
    (x, y, farthest.fold(0.0, f64::max) + 18.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sols_in_a_row_are_a_range() {
        assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1-3, 7, 9-10");
        assert_eq!((ranges(&[5]).as_str(), ranges(&[]).as_str()), ("5", ""));
        assert_eq!(ranges(&[u32::MAX - 1, u32::MAX]), "4294967294-4294967295");
    }

    #[test]
    fn a_map_has_north_up_and_east_to_the_right_at_any_extent() {
        let stop = |north: f64, east: f64| Stop {
            site: 1,
            drive: Some(1),
            position_m: [north, east],
            photos: 3,
            scenes: Vec::new(),
        };
        for scale in [0.0, 1e-3, 1.0, 1e6] {
            let stops = [stop(0.0, 0.0), stop(2.0 * scale, scale)];
            let stops: Vec<&Stop> = stops.iter().collect();
            let fit = Fit::new(&stops);
            let (a, b) = (fit.place(stops[0].position_m), fit.place(stops[1].position_m));
            assert!(a.0 <= b.0 && a.1 >= b.1, "{scale}: {a:?} {b:?}");
            for (x, y) in [a, b] {
                assert!(
                    (0.0..=WIDTH).contains(&x) && (0.0..=fit.height).contains(&y),
                    "{scale}: {x} {y}"
                );
            }
        }
    }

    #[test]
    fn a_circle_holds_its_places() {
        assert_eq!(circle(&[(10.0, 10.0)]), (10.0, 10.0, 18.0));
        assert_eq!(circle(&[(0.0, 0.0), (6.0, 8.0)]), (3.0, 4.0, 23.0));
    }
}
