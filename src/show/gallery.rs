//! Thumbnails of what the filters rejected, with their reasons, and of what stayed.

use marf_stage::{VERDICTS, Verdict};
use maud::{Markup, html};

use super::format::{count, number};
use super::input::NodeView;
use super::page::Page;
use super::photos::last_photo_nodes;
use super::review::{Closest, against, closest};
use super::thumbs::{name_of, thumb};

/// Most thumbnails of one gallery.
const MOST_THUMBS: usize = 60;

/// One gallery for each node that rejected photos.
pub(super) fn rejected(page: &Page<'_>) -> Markup {
    let galleries: Vec<Markup> = page
        .with_output(VERDICTS)
        .filter_map(|node| rejected_by(page, node))
        .collect();
    html! {
        @if galleries.is_empty() { p { "No filter rejected a photo." } }
        @for gallery in &galleries { (gallery) }
    }
}

fn rejected_by(page: &Page<'_>, node: &NodeView) -> Option<Markup> {
    let all = match page.verdicts(node) {
        Ok(all) => all,
        Err(missing) => return Some(html! { h3 { (node.name) } (missing) }),
    };
    let known = |verdict: &&Verdict| !verdict.keeps() && page.photos.get(&verdict.id).is_some();
    let rejected: Vec<&Verdict> = all.iter().filter(known).collect();
    if rejected.is_empty() {
        return None;
    }
    Some(html! {
        h3 { (node.name) ": " (count(rejected.len(), "photo")) " of " (all.len()) }
        div.gallery { @for verdict in rejected.iter().take(MOST_THUMBS) { (reject(page, verdict)) } }
        (not_shown(rejected.len()))
    })
}

fn reject(page: &Page<'_>, verdict: &Verdict) -> Markup {
    html! {
        figure.pair[verdict.twin.is_some()] {
            div.thumbs {
                (thumb(page, &verdict.id, "rejected photo"))
                @if let Some(twin) = &verdict.twin { (thumb(page, twin, "kept in its place")) }
            }
            figcaption {
                span.file { (verdict.file) }
                @if let Some(twin) = &verdict.twin {
                    span.twin { "kept in its place (right): " span.file { (name_of(page, twin)) } }
                }
                @if let Some(score) = score(verdict) { span { (score) } }
                @if !verdict.reason.is_empty() { span.quiet { (verdict.reason) } }
            }
        }
    }
}

/// `score 12.4, threshold 20, 7.6 below`.
fn score(verdict: &Verdict) -> Option<String> {
    let score = verdict.score?;
    let Some(threshold) = verdict.threshold else {
        return Some(format!("score {}", number(score)));
    };
    let distance = match score - threshold {
        0.0 => "at it".to_owned(),
        distance if distance > 0.0 => format!("{} above", number(distance)),
        distance => format!("{} below", number(-distance)),
    };
    Some(format!(
        "score {}, threshold {}, {distance}",
        number(score),
        number(threshold)
    ))
}

/// What was left at the end of the filters.
pub(super) fn kept(page: &Page<'_>) -> Markup {
    let last = last_photo_nodes(page.input);
    if last.is_empty() {
        return page.absent("photos");
    }
    let closest = closest(page);
    html! { @for node in last { (kept_by(page, node, &closest)) } }
}

fn kept_by(page: &Page<'_>, node: &NodeView, closest: &Closest<'_>) -> Markup {
    let ids = match page.photos.ids_of(&node.name) {
        Some(Ok(ids)) => ids,
        Some(Err(missing)) => return html! { (missing) },
        None => return page.absent("photos"),
    };
    html! {
        p { (count(ids.len(), "photo")) " after " (node.name) "." }
        div.gallery.small {
            @for id in spread(ids) {
                figure {
                    (thumb(page, id, "kept photo"))
                    figcaption {
                        span.file { (name_of(page, id)) }
                        @if let Some((filter, verdict, margin)) = closest.get(id) {
                            span.quiet { "closest: " (filter) " " (against(verdict, *margin)) }
                        }
                    }
                }
            }
        }
        (not_shown(ids.len()))
    }
}

/// At most [`MOST_THUMBS`], evenly from the whole list, so that every sol has its chance.
fn spread(ids: &[String]) -> impl Iterator<Item = &String> {
    let shown = ids.len().min(MOST_THUMBS);
    (0..shown).map(move |index| &ids[index * ids.len() / shown])
}

fn not_shown(number: usize) -> Markup {
    html! {
        @if number > MOST_THUMBS { p.quiet { (count(number - MOST_THUMBS, "photo")) " not shown." } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(score: Option<f64>, threshold: Option<f64>) -> Verdict {
        Verdict {
            id: "a".to_owned(),
            file: "a.jpg".to_owned(),
            verdict: "blur".to_owned(),
            score,
            threshold,
            twin: None,
            reason: String::new(),
        }
    }

    #[test]
    fn a_score_tells_its_distance_to_the_threshold() {
        let said = |value, threshold| score(&verdict(value, threshold));
        assert_eq!(
            said(Some(12.5), Some(20.0)).as_deref(),
            Some("score 12.5, threshold 20, 7.5 below")
        );
        assert_eq!(
            said(Some(3.0), Some(2.0)).as_deref(),
            Some("score 3, threshold 2, 1 above")
        );
        assert_eq!(
            said(Some(2.0), Some(2.0)).as_deref(),
            Some("score 2, threshold 2, at it")
        );
        assert_eq!(said(Some(2.0), None).as_deref(), Some("score 2"));
        assert_eq!(said(None, Some(2.0)), None);
    }

    #[test]
    fn a_long_list_is_shown_from_its_whole_length() {
        for length in [0, 1, 59, 60, 61, 1000] {
            let ids: Vec<String> = (0..length).map(|index| index.to_string()).collect();
            let shown: Vec<&String> = spread(&ids).collect();
            assert_eq!(shown.len(), length.min(MOST_THUMBS), "{length}");
            assert!(shown.windows(2).all(|pair| pair[0] != pair[1]), "{length}");
        }
    }
}
