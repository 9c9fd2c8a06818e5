//! Renders of held-out photos next to these photos, and films.

use std::collections::BTreeSet;

use marf_cache::Digest;
use marf_model::RunNode;
use marf_scene::{Image, Srgb};
use marf_schema::scores::{PhotoScores, Scores};
use marf_schema::{evaluate, folds, output, train};
use maud::{Markup, html};

use super::cameras::Plan;
use super::embed::{Form, decode, words};
use super::format::count;
use super::maps::uncertainty_of;
use super::page::{Page, has_document};
use super::quality::{by_distance, of_photo};
use super::read::Missing;

/// Most views of one node.
const MOST_VIEWS: usize = 12;
/// Most single frames instead of a film.
const MOST_FRAMES: usize = 12;
/// Error pictures show the difference this many times larger.
const ERROR_GAIN: u8 = 4;

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
        p.quiet { "Worst first. Error: |render - photo| x " (ERROR_GAIN) " in each channel." }
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
        h3 { (node.run.name) ": " (count(names.len(), "view")) }
        @if let Err(missing) = &scores { (missing) }
        @if let Ok(scores) = &scores { (by_distance(scores)) }
        @let plan = Plan::new(page, node);
        @for name in names.iter().take(MOST_VIEWS) { (judged(page, node, name, view(name), plan.as_ref())) }
        @if names.len() > MOST_VIEWS { p.quiet { (count(names.len() - MOST_VIEWS, "better view")) " not shown." } }
    }
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

/// Photo, render, error, uncertainty and place in a row, with the figures of the view.
fn judged(
    page: &Page<'_>,
    node: &RunNode,
    name: &str,
    scores: Option<&PhotoScores>,
    plan: Option<&Plan>,
) -> Markup {
    let place = scores.zip(plan).and_then(|(scores, plan)| {
        let nearest = scores.nearest.as_ref().map(|nearest| nearest.id.as_str());
        plan.whereabouts(&scores.id, nearest)
    });
    let render = node.digest(&format!("{}{name}.png", output::HELDOUT));
    let photo = node.digest(&format!("{}{name}.png", output::PHOTO));
    let stored = |digest: Option<&Digest>, what: &str| match digest {
        Some(digest) => page
            .pictures
            .stored(page.report, digest, Form::Photo, &format!("{what} of {name}")),
        None => words(&format!("The node has no {what} of this view.")),
    };
    html! {
        div.view {
            h4 { span.file { (name) } @for text in view_figures(scores) { span.quiet { (text) } } }
            div.row.judged {
                figure { (stored(photo, "photo")) figcaption { "photo" } }
                figure { (stored(render, "render")) figcaption { "render" } }
                figure { (error_picture(page, render, photo, name)) figcaption { "error x " (ERROR_GAIN) } }
                @if let Some((heading, map)) = uncertainty_of(page, node, name) {
                    figure { (stored(Some(map), heading)) figcaption { (heading) } }
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

fn error_picture(page: &Page<'_>, render: Option<&Digest>, photo: Option<&Digest>, name: &str) -> Markup {
    let (Some(render), Some(photo)) = (render, photo) else {
        return words("No error without both.");
    };
    let made = decode(page.report, render)
        .and_then(|render| decode(page.report, photo).map(|photo| (render, photo)))
        .and_then(|(render, photo)| difference(&render, &photo));
    match made {
        Ok(image) => page
            .pictures
            .own(&image, Form::Photo, &format!("error of {name}")),
        Err(why) => words(&why),
    }
}

/// |a - b| x [`ERROR_GAIN`] in each channel, at most 255.
fn difference(a: &Image<Srgb>, b: &Image<Srgb>) -> Result<Image<Srgb>, String> {
    if (a.width, a.height) != (b.width, b.height) {
        return Err(format!(
            "Render ({} x {} px) and photo ({} x {} px) differ in size.",
            a.width, a.height, b.width, b.height
        ));
    }
    let channel = |a: u8, b: u8| a.abs_diff(b).saturating_mul(ERROR_GAIN);
    let pixels = a.pixels.iter().zip(&b.pixels);
    Ok(Image {
        width: a.width,
        height: a.height,
        pixels: pixels
            .map(|(a, b)| [0, 1, 2].map(|index| channel(a[index], b[index])))
            .collect(),
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

    #[test]
    fn an_error_picture_saturates_and_refuses_another_size() {
        let photo = Image::from_fn(2, 1, |x, _| [10 + x as u8, 250, 0]);
        let render = Image::from_fn(2, 1, |_, _| [10, 100, 63]);
        assert_eq!(
            difference(&render, &photo).unwrap().pixels,
            [[0, 255, 252], [4, 255, 252]]
        );
        let other = Image::from_fn(1, 2, |_, _| [0; 3]);
        let error = difference(&render, &other).unwrap_err();
        assert!(error.contains("2 x 1") && error.contains("1 x 2"), "{error}");
    }
}
