//! How firm the verdicts are: what another threshold would change, and which photos are the closest calls.

use marf_stage::Verdict;
use maud::{Markup, html};

use super::call::{Call, FACTORS};
use super::format::{count, number};
use super::page::Page;
use super::thumbs::{name_of, thumb};
use super::verdicts::{Judged, Summary};

/// Draws the table of other thresholds, and the closest calls of each filter.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let judged: Vec<(&str, &Summary)> = page
        .judged()
        .filter_map(|(node, sum)| Some((node.run.name.as_str(), sum.ok()?)))
        .collect();
    if judged.iter().all(|(_, sum)| sum.calls == 0) {
        return page.absent("verdicts with a score and a threshold");
    }
    html! {
        p { "How many verdicts would change if a filter's threshold were smaller or larger. Try one: "
            code { "--set NODE.KEY=VALUE" } " decodes no photo again." }
        div.scroll { table {
            thead { tr {
                th { "Filter" } th.number { "Judged by score" } th.number { "Rejected" }
                @for factor in FACTORS { th.number { (percent(factor - 1.0)) } }
            } }
            tbody { @for (name, sum) in &judged { @if sum.calls > 0 { (row(name, sum)) } } }
        } }
        (overruled(&judged))
        @for (name, sum) in &judged { (closest_of(page, name, sum)) }
    }
}

fn row(name: &str, sum: &Summary) -> Markup {
    html! {
        tr {
            td { (name) }
            td.number { (sum.calls) }
            td.number { (sum.calls_rejected) }
            @for flips in sum.flips { td.number { (flips) } }
        }
    }
}

/// Verdicts that a person has given.
fn overruled(judged: &[(&str, &Summary)]) -> Markup {
    html! {
        @if judged.iter().any(|(_, sum)| !sum.by_hand.is_empty()) {
            h3 { "Overruled by hand" }
            div.scroll { table {
                thead { tr { th { "File" } th { "Filter" } th { "What" } } }
                tbody { @for (node, sum) in judged { @for Judged { verdict, .. } in &sum.by_hand {
                    tr { td.file { (verdict.file) } td { (node) } td { (verdict.reason) } }
                } } }
            } }
        }
    }
}

fn closest_of(page: &Page<'_>, name: &str, sum: &Summary) -> Markup {
    // A product that an archive's reader rejects has not become a photo.
    let calls = sum
        .closest
        .iter()
        .filter(|judged| page.photos.get(&judged.verdict.id).is_some())
        .filter_map(|judged| Some((&judged.verdict, Call::from_verdict(&judged.verdict)?.margin())));
    html! {
        @if sum.near > 0 {
            h3 { (name) ": closest calls, " (count(sum.near, "verdict")) " of " (sum.seen) " within half of their threshold" }
            div.gallery.small {
                @for (verdict, margin) in calls {
                    figure {
                        (thumb(page, &verdict.id, "closest call"))
                        figcaption {
                            span.file { (name_of(page, &verdict.id)) }
                            span { (if verdict.keeps() { "kept" } else { "rejected" }) ", " (against(verdict, margin)) }
                            @if verdict.keeps() && !verdict.reason.is_empty() { span.quiet { (verdict.reason) } }
                        }
                    }
                }
            }
        }
    }
}

/// `21.5 against 9.3, 131 % above`.
pub(super) fn against(verdict: &Verdict, margin: f64) -> String {
    let (score, threshold) = (verdict.score.unwrap_or(0.0), verdict.threshold.unwrap_or(0.0));
    let side = if margin < 0.0 { "below" } else { "above" };
    format!(
        "{} against {}, {} % {side}",
        number(score),
        number(threshold),
        number((1000.0 * margin.abs()).round() / 10.0)
    )
}

/// `-20 %`, `+5 %`.
pub fn percent(share: f64) -> String {
    format!("{:+.0} %", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(keeps: bool, score: f64, threshold: f64) -> Verdict {
        Verdict {
            id: "a".to_owned(),
            file: "a.jpg".to_owned(),
            verdict: if keeps { "keep" } else { "blur" }.to_owned(),
            score: Some(score),
            threshold: Some(threshold),
            twin: None,
            reason: String::new(),
        }
    }

    #[test]
    fn a_verdict_flips_when_its_threshold_passes_its_score() {
        // Kept above or rejected below: a least. Kept below or rejected above (or at it): a most.
        for (keeps, score, threshold, factor, flips) in [
            (true, 11.0, 10.0, 1.05, false),
            (true, 11.0, 10.0, 1.2, true),
            (true, 11.0, 10.0, 0.8, false),
            (false, 9.0, 10.0, 0.95, false),
            (false, 9.0, 10.0, 0.8, true),
            (true, 0.94, 0.975, 0.95, true),
            (true, 0.94, 0.975, 1.1, false),
            (false, 0.975, 0.975, 1.05, true),
            (false, 0.975, 0.975, 0.9, false),
        ] {
            let call = Call::from_verdict(&verdict(keeps, score, threshold)).unwrap();
            assert_eq!(
                call.flips_at(factor),
                flips,
                "{keeps} {score} {threshold} {factor}"
            );
            assert!(!call.flips_at(1.0), "{keeps} {score} {threshold} as it is");
        }
    }

    #[test]
    fn a_verdict_without_numbers_or_by_hand_is_no_call() {
        let bare = Verdict {
            score: None,
            ..verdict(true, 0.0, 1.0)
        };
        let hand = Verdict {
            reason: "kept by hand, against the filter: x".to_owned(),
            ..verdict(true, 0.5, 1.0)
        };
        for no_call in [bare, hand, verdict(true, 3.0, 0.0), verdict(true, f64::NAN, 1.0)] {
            assert_eq!(Call::from_verdict(&no_call), None, "{no_call:?}");
        }
    }

    #[test]
    fn margins_are_percentages() {
        let verdict = verdict(true, 21.5, 9.3);
        let margin = Call::from_verdict(&verdict).unwrap().margin();
        assert_eq!(against(&verdict, margin), "21.5 against 9.3, 131.2 % above");
        assert_eq!(
            (percent(-0.2), percent(0.05)),
            ("-20 %".to_owned(), "+5 %".to_owned())
        );
    }
}
