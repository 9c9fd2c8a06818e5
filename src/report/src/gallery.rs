//! Thumbnails of what the filters rejected, with their reasons, and of what stayed.

use marf_model::RunNode;
use marf_stage::Verdict;
use maud::{Markup, html};

use super::format::{count, number};
use super::page::Page;
use super::photos::Kept;
use super::read::Missing;
use super::review::against;
use super::thumbs::{name_of, thumb};
use super::verdicts::Summary;

/// One gallery for each node that rejected photos.
pub(super) fn rejected(page: &Page<'_>) -> Markup {
    let galleries: Vec<Markup> = page
        .judged()
        // A product that a source rejects has not become a photo.
        .filter(|(node, _)| !node.run.edges.is_empty())
        .filter_map(|(node, sum)| rejected_by(page, node, sum))
        .collect();
    html! {
        @if galleries.is_empty() { p { "No filter rejected a photo." } }
        @for gallery in &galleries { (gallery) }
    }
}

fn rejected_by(page: &Page<'_>, node: &RunNode, sum: Result<&Summary, &Missing>) -> Option<Markup> {
    let sum = match sum {
        Ok(sum) => sum,
        Err(missing) => return Some(html! { h3 { (node.run.name) } (missing) }),
    };
    let rejected = sum.seen - sum.kept;
    (rejected > 0).then(|| {
        html! {
            h3 { (node.run.name) ": " (count(rejected, "photo")) " of " (sum.seen) }
            div.gallery { @for judged in &sum.first_rejected { (reject(page, &judged.verdict)) } }
            (not_shown(rejected, sum.first_rejected.len()))
        }
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

/// The photos that all filters keep.
pub(super) fn kept(page: &Page<'_>) -> Markup {
    if page.kept.is_empty() {
        return page.absent("photos");
    }
    html! { @for (node, kept) in &page.kept { (kept_by(page, node, kept)) } }
}

fn kept_by(page: &Page<'_>, node: &RunNode, kept: &Result<Kept, Missing>) -> Markup {
    let kept = match kept {
        Ok(kept) => kept,
        Err(missing) => return html! { (missing) },
    };
    html! {
        p { (count(kept.count, "photo")) " after " (node.run.name) "." }
        div.gallery.small {
            @for (_, id) in &kept.shown {
                figure {
                    (thumb(page, id, "kept photo"))
                    figcaption {
                        span.file { (name_of(page, id)) }
                        @if let Some((filter, verdict, margin)) = page.closest.get(id) {
                            span.quiet { "closest: " (filter) " " (against(verdict, *margin)) }
                        }
                    }
                }
            }
        }
        (not_shown(kept.count, kept.shown.len()))
    }
}

/// Says how many photos are not shown.
pub(super) fn not_shown(number: usize, shown: usize) -> Markup {
    let rest = number.saturating_sub(shown);
    html! { @if rest > 0 { p.quiet { (count(rest, "photo")) " not shown." } } }
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
}
