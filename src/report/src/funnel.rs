//! Number of photos into and out of each filter.

use marf_model::RunNode;
use maud::{Markup, html};

use super::format::{count, cut, px};
use super::gallery::not_shown;
use super::page::{Page, key};
use super::report::stage;
use super::verdicts::{Judged, Summary};
use crate::emptied;

const BAR_LEFT: f64 = 150.0;
const BAR_WIDTH: f64 = 440.0;
const BAR_HEIGHT: f64 = 20.0;
const PITCH: f64 = 30.0;
const WIDTH: f64 = 1040.0;

/// Draws the funnel and lists the files that could not be read.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let (mut shown, mut missing) = (Vec::new(), Vec::new());
    for (node, sum) in page.judged() {
        match sum {
            Ok(sum) => shown.push((node, sum)),
            Err(why) => missing.push(why),
        }
    }
    if shown.is_empty() && missing.is_empty() {
        return page.absent("verdicts on photos");
    }
    html! {
        (drawing(&shown))
        @for (_, sum) in &shown { @for line in sum.kept_as_lines() { p { (line) "." } } }
        @for (node, sum) in &shown { (emptied(node, sum)) }
        @for missing in missing.into_iter().chain(page.photos.missing()) { (missing) }
        @for (node, sum) in &shown { @if node.run.edges.is_empty() { (no_photos(sum)) } }
    }
}

/// Says what keeps the photos of a filter that rejects all of them.
fn emptied(node: &RunNode, sum: &Summary) -> Markup {
    let relax = stage(node).and_then(|stage| stage.relax);
    let relax = relax.filter(|_| sum.seen > 0 && sum.kept == 0);
    html! { @if let Some(relax) = relax { p.missing { (emptied::sentence(&node.run.name, sum.seen as u64, relax)) } } }
}

/// `7 in, 6 kept, 1 rejected (1 decode)`.
fn sentence(sum: &Summary) -> String {
    let kinds: Vec<String> = sum
        .rejected
        .iter()
        .map(|(kind, number)| format!("{number} {}", cut(kind, 24)))
        .collect();
    match sum.seen - sum.kept {
        0 => format!("{} in, all kept", sum.seen),
        rejected => format!(
            "{} in, {} kept, {rejected} rejected ({})",
            sum.seen,
            sum.kept,
            kinds.join(", ")
        ),
    }
}

fn drawing(shown: &[(&RunNode, &Summary)]) -> Markup {
    let most = shown.iter().map(|(_, sum)| sum.seen).max().unwrap_or(0).max(1);
    let height = shown.len() as f64 * PITCH;
    html! {
        div.scroll {
            svg.funnel viewBox={ "0 0 " (px(WIDTH)) " " (px(height)) } width=(px(WIDTH)) height=(px(height))
                role="img" aria-label="Photos into and out of each filter" {
                @for (index, (node, sum)) in shown.iter().enumerate() {
                    (bar(node, sum, index as f64 * PITCH, BAR_WIDTH / most as f64))
                }
            }
        }
        p.legend { (key("kept", "kept")) (key("rejected", "rejected")) }
    }
}

fn bar(node: &RunNode, sum: &Summary, top: f64, px_each: f64) -> Markup {
    let kept = sum.kept as f64 * px_each;
    let seen = sum.seen as f64 * px_each;
    let base = top + 15.0;
    html! {
        g {
            title { (node.run.name) ": " (sentence(sum)) }
            text.name x=(px(BAR_LEFT - 10.0)) y=(px(base)) text-anchor="end" { (cut(&node.run.name, 18)) }
            rect.rejected x=(px(BAR_LEFT + kept)) y=(px(top)) width=(px(seen - kept)) height=(px(BAR_HEIGHT)) {}
            rect.kept x=(px(BAR_LEFT)) y=(px(top)) width=(px(kept)) height=(px(BAR_HEIGHT)) {}
            text x=(px(BAR_LEFT + seen + 10.0)) y=(px(base)) { (sentence(sum)) }
        }
    }
}

/// Files that gave no photo at all: they have no picture, only a reason.
fn no_photos(sum: &Summary) -> Markup {
    let rejected = sum.seen - sum.kept;
    html! {
        @if rejected > 0 {
            h3 { (count(rejected, "file")) " that gave no photo" }
            div.scroll {
                table {
                    thead { tr { th { "File" } th { "Verdict" } th { "Why" } } }
                    tbody {
                        @for Judged { verdict, .. } in &sum.first_rejected {
                            tr { td.file { (verdict.file) } td { (verdict.verdict) } td { (verdict.reason) } }
                        }
                    }
                }
            }
            (not_shown(rejected, sum.first_rejected.len()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::node;

    #[test]
    fn a_filter_that_rejects_all_says_what_keeps_them_and_others_say_nothing() {
        let filter = node("grayscale", &["size"]);
        let sum = |kept| Summary {
            seen: 3,
            kept,
            ..Summary::default()
        };
        let said = emptied(&filter, &sum(0)).into_string();
        assert!(
            said.contains("rejects all 3 photos") && said.contains("in `[node.grayscale]` keeps them"),
            "{said}"
        );
        let one = emptied::sentence("grayscale", 1, "x");
        assert!(one.starts_with("`grayscale` rejects the only photo"), "{one}");
        for silent in [emptied(&filter, &sum(1)), emptied(&node("extract", &[]), &sum(0))] {
            assert_eq!(silent.into_string(), "");
        }
    }
}
