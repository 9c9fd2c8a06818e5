//! How firm the verdicts are: what another threshold would change, and which photos are the closest calls.

use std::collections::BTreeMap;

use marf_stage::{VERDICTS, Verdict};
use maud::{Markup, html};

use super::format::{count, number};
use super::page::Page;
use super::thumbs::{name_of, thumb};

/// Thresholds that are tried, as multiples of those in force.
pub const FACTORS: [f64; 6] = [0.8, 0.9, 0.95, 1.05, 1.1, 1.2];
/// Closest calls shown for each filter.
const CLOSEST: usize = 6;
/// What is further from its threshold than this share of it is no close call.
const NEAR: f64 = 0.5;

/// A verdict that rests on a score and a threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Call {
    keeps: bool,
    score: f64,
    threshold: f64,
}

impl Call {
    /// Reads it from a verdict; none where there is no score or threshold, or a person has decided.
    pub fn of(verdict: &Verdict) -> Option<Self> {
        let manual =
            verdict.reason.starts_with("kept by hand") || verdict.reason.starts_with("rejected by hand");
        let call = Self {
            keeps: verdict.keeps(),
            score: verdict.score?,
            threshold: verdict.threshold?,
        };
        let sound = call.score.is_finite() && call.threshold.is_finite() && call.threshold != 0.0;
        (sound && !manual).then_some(call)
    }

    /// Returns how far the score lies above the threshold, as a share of it; negative below.
    pub fn margin(&self) -> f64 {
        (self.score - self.threshold) / self.threshold.abs()
    }

    /// Tells whether the verdict would be another one if the threshold were so many times as large. Only this score
    /// counts: other measures of the filter stay as they are.
    pub fn flips_at(&self, factor: f64) -> bool {
        // The side on which photos go: where a rejected one is, and a kept one is not.
        let high_goes = (self.score >= self.threshold) != self.keeps;
        let threshold = self.threshold * factor;
        let goes = match high_goes {
            true => self.score >= threshold,
            false => self.score < threshold,
        };
        goes == self.keeps
    }
}

/// Returns the calls among some verdicts.
pub fn calls(verdicts: &[Verdict]) -> Vec<Call> {
    verdicts.iter().filter_map(Call::of).collect()
}

/// For each photo the verdict that was closest to falling the other way, and the node that gave it.
pub(super) type Closest<'a> = BTreeMap<String, (&'a str, Verdict, f64)>;

/// Returns the closest call of every photo of the run.
pub(super) fn closest<'a>(page: &Page<'a>) -> Closest<'a> {
    let mut closest = Closest::new();
    for node in page.with_output(VERDICTS) {
        for verdict in page.verdicts(node).unwrap_or_default() {
            let Some(call) = Call::of(verdict) else { continue };
            let margin = call.margin();
            let nearer = closest
                .get(&verdict.id)
                .is_none_or(|(_, _, known)| margin.abs() < known.abs());
            if nearer {
                closest.insert(verdict.id.clone(), (&node.name, verdict.clone(), margin));
            }
        }
    }
    closest
}

/// Draws the table of other thresholds, and the closest calls of each filter.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let judged: Vec<(&str, &[Verdict])> = page
        .with_output(VERDICTS)
        .filter_map(|node| Some((node.name.as_str(), page.verdicts(node).ok()?)))
        .filter(|(_, verdicts)| verdicts.iter().any(|verdict| Call::of(verdict).is_some()))
        .collect();
    if judged.is_empty() {
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
            tbody { @for (name, verdicts) in &judged { (row(name, &calls(verdicts))) } }
        } }
        (overruled(page))
        @for (name, verdicts) in &judged { (closest_of(page, name, verdicts)) }
    }
}

fn row(name: &str, calls: &[Call]) -> Markup {
    let flips = |factor: f64| calls.iter().filter(|call| call.flips_at(factor)).count();
    html! {
        tr {
            td { (name) }
            td.number { (calls.len()) }
            td.number { (calls.iter().filter(|call| !call.keeps).count()) }
            @for factor in FACTORS { td.number { (flips(factor)) } }
        }
    }
}

/// Verdicts that a person has given.
fn overruled(page: &Page<'_>) -> Markup {
    let all = page.with_output(VERDICTS).flat_map(|node| {
        let verdicts = page.verdicts(node).unwrap_or_default();
        verdicts.iter().map(|verdict| (node.name.as_str(), verdict))
    });
    let overruled: Vec<(&str, &Verdict)> = all
        .filter(|(_, verdict)| {
            verdict.reason.starts_with("kept by hand, against")
                || verdict.reason.starts_with("rejected by hand")
        })
        .collect();
    html! {
        @if !overruled.is_empty() {
            h3 { "Overruled by hand" }
            div.scroll { table {
                thead { tr { th { "File" } th { "Filter" } th { "What" } } }
                tbody { @for (node, verdict) in &overruled {
                    tr { td.file { (verdict.file) } td { (node) } td { (verdict.reason) } }
                } }
            } }
        }
    }
}

fn closest_of(page: &Page<'_>, name: &str, verdicts: &[Verdict]) -> Markup {
    let mut near: Vec<(f64, &Verdict)> = verdicts
        .iter()
        .filter_map(|verdict| Some((Call::of(verdict)?.margin(), verdict)))
        .filter(|(margin, verdict)| margin.abs() <= NEAR && page.photos.get(&verdict.id).is_some())
        .collect();
    near.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()).then_with(|| a.1.id.cmp(&b.1.id)));
    html! {
        @if !near.is_empty() {
            h3 { (name) ": closest calls, " (count(near.len(), "verdict")) " of " (verdicts.len()) " within half of their threshold" }
            div.gallery.small {
                @for (margin, verdict) in near.iter().take(CLOSEST) {
                    figure {
                        (thumb(page, &verdict.id, "closest call"))
                        figcaption {
                            span.file { (name_of(page, &verdict.id)) }
                            span { (if verdict.keeps() { "kept" } else { "rejected" }) ", " (against(verdict, *margin)) }
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
            let call = Call::of(&verdict(keeps, score, threshold)).unwrap();
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
            assert_eq!(Call::of(&no_call), None, "{no_call:?}");
        }
    }

    #[test]
    fn margins_are_percentages() {
        let verdict = verdict(true, 21.5, 9.3);
        let margin = Call::of(&verdict).unwrap().margin();
        assert_eq!(against(&verdict, margin), "21.5 against 9.3, 131.2 % above");
        assert_eq!(
            (percent(-0.2), percent(0.05)),
            ("-20 %".to_owned(), "+5 %".to_owned())
        );
    }
}
