//! Renders of held-out photos next to these photos, and films.

use std::collections::BTreeSet;

use marf_cache::Digest;
use marf_model::RunNode;
use marf_scene::picture::{ColorScale, Palette, draw_map, quantile, round_upper_limit};
use marf_scene::{Image, Srgb};
use marf_schema::evaluate::{self, EvaluateParams, Which};
use marf_schema::scores::{PhotoScores, Scores};
use marf_schema::{folds, output, train};
use maud::{Markup, html};

use super::cameras::Plan;
use super::embed::{Form, decode, shrunk, words};
use super::format::count;
use super::maps::uncertainty_of;
use super::page::{Page, has_document};
use super::quality::{by_distance, of_photo};
use super::read::Missing;

/// Most views of one node.
const MOST_VIEWS: usize = 12;
/// Most single frames instead of a film.
const MOST_FRAMES: usize = 12;
/// Longest side of an error map, pixels.
const ERROR_PX: u32 = 480;
/// Share of the pixels of every photo within the scale of the errors.
const WITHIN: f64 = 0.95;

/// Held-out views of every node that rendered some, worst first.
pub(super) fn held_out(page: &Page<'_>) -> Markup {
    let mut shown: BTreeSet<Vec<Digest>> = BTreeSet::new();
    let parts: Vec<Markup> = page
        .with_outputs_under(output::HELDOUT)
        .filter(|node| !page.is_replaced(node))
        .map(|node| {
            if shown.insert(digests(node, output::HELDOUT)) {
                views(page, node)
            } else {
                html! { h3 { (node.run.name) } p { "The same renders as above." } }
            }
        })
        .collect();
    if parts.is_empty() {
        return page.absent("renders of held-out photos");
    }
    html! {
        p.quiet {
            "Worst first. Error: |render - photo|, mean of the channels. All photos of a node share its scale, and 95 % of the pixels of "
            "each are within it. Larger errors have the top colour."
        }
        @for part in parts { (part) }
    }
}

fn digests(node: &RunNode, prefix: &str) -> Vec<Digest> {
    node.outputs_under(prefix).map(|(_, digest)| *digest).collect()
}

fn views(page: &Page<'_>, node: &RunNode) -> Markup {
    let scores = scores(page, node);
    let views = scores.as_ref().map_or(&[][..], |scores| &scores.views);
    let view = |name: &str| views.iter().find(|view| view.name == name);
    let held_out = node.outputs_under(output::HELDOUT);
    let mut names: Vec<&str> = held_out
        .filter_map(|(name, _)| name.strip_suffix(".png"))
        .collect();
    // Ties, and views without a figure, keep the order of their names.
    let psnr = |name: &str| view(name).map_or(f64::MAX, |view| view.psnr);
    names.sort_by(|a, b| psnr(a).total_cmp(&psnr(b)));
    html! {
        h3 {
            (node.run.name) ": " (count(names.len(), "view"))
            @if let Some(trained) = trained_on(page, node, views) { ", " (trained) " of photos trained on" }
        }
        @if let Err(missing) = &scores { (missing) }
        @if let Ok(scores) = &scores { (by_distance(scores)) }
        @let plan = Plan::new(page, node);
        @let errors = Errors::new(page, node, &names[..names.len().min(MOST_VIEWS)]);
        @for (name, error) in &errors.maps {
            @let error = errors.picture(page, name, error);
            (judged(page, node, &View { name, scores: view(name), error }, plan.as_ref()))
        }
        @if names.len() > MOST_VIEWS { p.quiet { (count(names.len() - MOST_VIEWS, "better view")) " not shown." } }
    }
}

/// Returns how many of the photos of an evaluation were trained on. `None` if it is one of held-out photos.
fn trained_on(page: &Page<'_>, node: &RunNode, views: &[PhotoScores]) -> Option<usize> {
    let params = page.report.params.get(&node.run.name)?.clone();
    let params: EvaluateParams = serde_json::from_value(params).ok()?;
    let shows_others = has_document::<evaluate::Metrics>(node) && params.views != Which::Heldout;
    // They have no nearest one.
    shows_others.then(|| views.iter().filter(|view| view.nearest.is_none()).count())
}

/// Reads the scores of a training or an evaluation.
fn scores(page: &Page<'_>, node: &RunNode) -> Result<Scores, Missing> {
    if has_document::<evaluate::Metrics>(node) {
        return Ok(page.document::<evaluate::Metrics>(node)?.scores);
    }
    if has_document::<folds::Metrics>(node) {
        let judged = page.document::<folds::Metrics>(node)?.judged;
        return Ok(judged.map_or_else(Scores::default, |judged| judged.scores));
    }
    Ok(page.document::<train::Metrics>(node)?.scores)
}

/// A held-out view: its name, its figures, and the map of its errors.
struct View<'a> {
    name: &'a str,
    scores: Option<&'a PhotoScores>,
    error: Markup,
}

/// Photo, render, error, uncertainty and place in a row, with the figures of the view.
fn judged(page: &Page<'_>, node: &RunNode, view: &View<'_>, plan: Option<&Plan>) -> Markup {
    let View { name, scores, error } = view;
    let place = scores.zip(plan).and_then(|(scores, plan)| {
        let nearest = scores.nearest.as_ref().map(|nearest| nearest.id.as_str());
        plan.whereabouts(&scores.id, nearest)
    });
    let shown = |digest: Option<&Digest>, form: Form, what: &str| match digest {
        Some(digest) => page
            .pictures
            .stored(page.report, digest, form, &format!("{what} of {name}")),
        None => words(&format!("The node has no {what} of this view.")),
    };
    let stored = |prefix: &str, what: &'static str| {
        let digest = node.digest(&format!("{prefix}{name}.png"));
        shown(digest, Form::Panel(what), what)
    };
    html! {
        div.view {
            h4 { span.file { (name) } @for text in view_figures(*scores) { span.quiet { (text) } } }
            div.row.judged {
                figure { (stored(output::PHOTO, "photo")) figcaption { "photo" } }
                figure { (stored(output::HELDOUT, "render")) figcaption { "render" } }
                figure { (error) figcaption { "error, gray levels" } }
                @if let Some((heading, map)) = uncertainty_of(page, node, name) {
                    figure { (shown(Some(map), Form::Map, heading)) figcaption { (heading) } }
                }
                @if let Some(place) = place { figure { (place) figcaption { "where, from above, ringed: nearest trained on" } } }
            }
        }
    }
}

fn view_figures(scores: Option<&PhotoScores>) -> Vec<String> {
    let Some(scores) = scores else {
        return vec!["no figures recorded".to_owned()];
    };
    let named = of_photo(scores).into_iter();
    named.map(|(name, text)| format!("{name} {text}")).collect()
}

/// Errors of the held-out views of a node, on one scale.
struct Errors<'a> {
    /// By view: an error as the gray of each pixel, or why there is none.
    maps: Vec<(&'a str, Result<Image<Srgb>, String>)>,
    scale: ColorScale,
}

impl<'a> Errors<'a> {
    fn new(page: &Page<'_>, node: &RunNode, names: &[&'a str]) -> Self {
        let maps: Vec<_> = names
            .iter()
            .map(|name| (*name, error_of(page, node, name)))
            .collect();
        let high = end(maps.iter().filter_map(|(_, error)| error.as_ref().ok()));
        Self {
            maps,
            scale: ColorScale::linear("error", "gray levels", high, Palette::Inferno),
        }
    }

    /// Shows the errors of a view.
    fn picture(&self, page: &Page<'_>, name: &str, error: &Result<Image<Srgb>, String>) -> Markup {
        match error {
            Ok(error) => {
                let map = draw_map(&levels(error), error.width, error.height, &self.scale);
                page.pictures.own(&map, Form::Map, &format!("error of {name}"))
            }
            Err(why) => words(why),
        }
    }
}

/// Returns the end of the scale of some errors: at least one gray level.
fn end<'e>(errors: impl Iterator<Item = &'e Image<Srgb>>) -> f64 {
    let tops: Vec<f32> = errors.map(|error| quantile(&levels(error), WITHIN)).collect();
    round_upper_limit(&tops, 1.0).max(1.0)
}

/// Returns the errors of a view at the size of its map.
fn error_of(page: &Page<'_>, node: &RunNode, name: &str) -> Result<Image<Srgb>, String> {
    let digest = |prefix: &str| node.digest(&format!("{prefix}{name}.png"));
    let (Some(render), Some(photo)) = (digest(output::HELDOUT), digest(output::PHOTO)) else {
        return Err("No error without both.".to_owned());
    };
    let (render, photo) = (decode(page.report, render)?, decode(page.report, photo)?);
    shrunk(&difference(&render, &photo)?, ERROR_PX)
}

/// Returns the values of an error map.
fn levels(error: &Image<Srgb>) -> Vec<f32> {
    error.pixels.iter().map(|rgb| f32::from(rgb[0])).collect()
}

/// Returns |a - b|, the mean of the channels, as gray.
fn difference(a: &Image<Srgb>, b: &Image<Srgb>) -> Result<Image<Srgb>, String> {
    if (a.width, a.height) != (b.width, b.height) {
        return Err(format!(
            "Render ({} x {} px) and photo ({} x {} px) differ in size.",
            a.width, a.height, b.width, b.height
        ));
    }
    let pixels = a.pixels.iter().zip(&b.pixels).map(|(a, b)| {
        let sum: u32 = (0..3)
            .map(|channel| u32::from(a[channel].abs_diff(b[channel])))
            .sum();
        [((sum + 1) / 3) as u8; 3]
    });
    Ok(Image {
        width: a.width,
        height: a.height,
        pixels: pixels.collect(),
    })
}

/// The first film, or else the best held-out view next to its photo. Empty if there is neither.
pub(super) fn best(page: &Page<'_>) -> Markup {
    let films = page.report.nodes.iter();
    let films = films.filter_map(|node| Some((node, node.digest(output::VIDEO)?)));
    let shown = films.filter_map(|(node, digest)| {
        let alt = format!("fly-through by {}", node.run.name);
        page.pictures.film(page.report, digest, &alt).ok()
    });
    if let Some(film) = shown.take(1).next() {
        return html! { figure { (film) figcaption { "fly-through of the field" } } };
    }
    let Some(node) = page.training() else {
        return html! {};
    };
    let field = page
        .awaited(node)
        .map_or("the field from there", |_| "draft of the field from there");
    let scores = scores(page, node).unwrap_or_default();
    let best = scores.views.iter().max_by(|a, b| a.psnr.total_cmp(&b.psnr));
    html! {
        @if let Some(view) = best {
            @for (prefix, what) in [(output::PHOTO, "held-out photo"), (output::HELDOUT, field)] {
                @if let Some(digest) = node.digest(&format!("{prefix}{}.png", view.name)) {
                    figure {
                        (page.pictures.stored(page.report, digest, Form::Photo, &format!("{what} {}", view.name)))
                        figcaption { (what) ": " (view.file) }
                    }
                }
            }
        }
    }
}

/// Films, or single frames of a node without a usable film.
pub(super) fn flights(page: &Page<'_>) -> Markup {
    let nodes = &page.report.nodes;
    let is_film = |node: &RunNode| node.digest(output::VIDEO).is_some();
    let filmed: BTreeSet<&str> = nodes
        .iter()
        .filter(|node| is_film(node))
        .flat_map(|node| page.report.upstream(node))
        .collect();
    let flies =
        |node: &&RunNode| is_film(node) || (has_frames(node) && !filmed.contains(node.run.name.as_str()));
    let nodes: Vec<&RunNode> = nodes.iter().copied().filter(flies).collect();
    if nodes.is_empty() {
        return page.absent("a fly-through");
    }
    html! { @for node in nodes { (flight(page, node)) } }
}

/// Returns true if a node made the single pictures of a film.
fn has_frames(node: &RunNode) -> bool {
    frames(node).next().is_some()
}

/// Returns the single pictures of a film by name.
fn frames(node: &RunNode) -> impl Iterator<Item = (&str, &Digest)> {
    let frames = node.outputs_under(output::FRAMES);
    frames.filter_map(|(name, digest)| Some((name.strip_suffix(".png")?, digest)))
}

fn flight(page: &Page<'_>, node: &RunNode) -> Markup {
    let frames = frames_of(page, node);
    let alt = format!("fly-through by {}", node.run.name);
    let film = node.digest(output::VIDEO).map(|digest| {
        if page.pictures.has_film(digest) {
            return Ok(html! { p { "This film is at the top of the page." } });
        }
        page.pictures.film(page.report, digest, &alt)
    });
    let has_uncertainty = frames.outputs_under(output::UNCERTAINTY).next().is_some();
    html! {
        h3 {
            (node.run.name)
            @if frames.run.name != node.run.name { " of " (frames.run.name) }
            @if has_uncertainty { ": with the uncertainty of the retrainings" }
        }
        @match film {
            Some(Ok(film)) => (film),
            Some(Err(why)) => { p.missing { (why) } (single_frames(page, frames)) }
            None => (single_frames(page, frames)),
        }
    }
}

/// Returns the node that made the pictures of a film: the one that `video` reads, or the node itself.
fn frames_of<'p>(page: &'p Page<'_>, node: &'p RunNode) -> &'p RunNode {
    let upstream = page.report.upstream(node).into_iter();
    let mut nodes = upstream.filter_map(|name| page.report.node(name));
    nodes.find(|node| has_frames(node)).unwrap_or(node)
}

fn single_frames(page: &Page<'_>, node: &RunNode) -> Markup {
    let frames: Vec<(&str, &Digest)> = frames(node).collect();
    let shown = frames.len().min(MOST_FRAMES);
    html! {
        p.quiet { (shown) " of " (count(frames.len(), "frame")) "." }
        div.gallery {
            @for index in 0..shown {
                @let (name, digest) = frames[index * frames.len() / shown];
                figure {
                    (page.pictures.stored(page.report, digest, Form::Thumb, &format!("frame {name}")))
                    figcaption { (name) }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 95 of the levels 0 to 99 do not exceed 94, and 3 is less.
    #[test]
    fn the_scale_of_errors_holds_95_percent_of_the_pixels_of_each_photo() {
        let rising = Image::from_fn(100, 1, |x, _| [x as u8; 3]);
        let plain = |level: u8| Image::from_fn(4, 1, |_, _| [level; 3]);
        assert_eq!(end([&rising, &plain(3)].into_iter()), 100.0);
        assert_eq!(end([&plain(3)].into_iter()), 5.0);
        assert_eq!(end([&plain(0)].into_iter()), 1.0);
        assert_eq!(end([].into_iter()), 1.0);
    }

    /// (0 + 150 + 63) / 3 = 71, (1 + 150 + 63) / 3 = 71.3.
    #[test]
    fn an_error_is_the_mean_of_the_channels_and_another_size_is_refused() {
        let photo = Image::from_fn(2, 1, |x, _| [10 + x as u8, 250, 0]);
        let render = Image::from_fn(2, 1, |_, _| [10, 100, 63]);
        assert_eq!(difference(&render, &photo).unwrap().pixels, [[71; 3], [71; 3]]);
        assert_eq!(difference(&photo, &photo).unwrap().pixels, [[0; 3]; 2]);
        let other = Image::from_fn(1, 2, |_, _| [0; 3]);
        let error = difference(&render, &other).unwrap_err();
        assert!(error.contains("2 x 1") && error.contains("1 x 2"), "{error}");
    }
}
