//! Trials of the parameters: the chosen one marked, and why it was chosen.

use marf_model::RunNode;
use marf_schema::tune::{BestParams, Scatter, Trial, Trials};
use maud::{Markup, html};

use super::format::{decibels, number, similarity};
use super::json;
use super::page::Page;

/// Columns before that of the parameters, in the order of [`scores`].
const SCORES: [&str; 6] = ["trial", "rank", "steps", "psnr", "psnr_paper", "ssim"];

/// The table of trials of every node that has one.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let nodes: Vec<&RunNode> = page.with_document::<Trials>().collect();
    if nodes.is_empty() {
        return page.absent("trials of parameters");
    }
    html! { @for node in nodes { h3 { (node.run.name) } (of_node(page, node)) } }
}

fn of_node(page: &Page<'_>, node: &RunNode) -> Markup {
    let trials = match page.document(node) {
        Ok(Trials(trials)) => trials,
        Err(missing) => return html! { (missing) },
    };
    html! {
        @match page.document::<Scatter>(node) {
            Ok(scatter) => { p { (decided(&scatter, &trials)) } (table(&trials, scatter.chosen)) },
            Err(missing) => (missing),
        }
        @match page.document::<BestParams>(node) {
            Ok(params) => (json::folded("chosen parameters", &params)),
            Err(missing) => (missing),
        }
    }
}

/// By rank.
fn table(trials: &[Trial], chosen: u32) -> Markup {
    let mut sorted: Vec<&Trial> = trials.iter().collect();
    sorted.sort_by_key(|trial| trial.rank);
    html! {
        div.scroll {
            table {
                thead { tr {
                    th {}
                    @for name in SCORES { th.number { (name) } }
                    th { "parameters" }
                } }
                tbody {
                    @for trial in sorted {
                        @let is_chosen = trial.trial == chosen;
                        tr.best[is_chosen] {
                            td { @if is_chosen { strong { "chosen" } } }
                            @for score in scores(trial) { td.number { (score) } }
                            td { code { (serde_json::to_string(&trial.params).unwrap_or_default()) } }
                        }
                    }
                }
            }
        }
    }
}

fn scores(trial: &Trial) -> [String; 6] {
    let known = |value: Option<f64>, text: fn(f64) -> String| value.map_or_else(|| "–".to_owned(), text);
    [
        trial.trial.to_string(),
        trial.rank.to_string(),
        number(trial.steps as f64),
        decibels(trial.psnr),
        known(trial.psnr_paper, decibels),
        known(trial.ssim, similarity),
    ]
}

/// Says what was decided, and how scores compare.
fn decided(scatter: &Scatter, trials: &[Trial]) -> String {
    let mut letters = scatter.decision.chars();
    let first = letters.next().map(|letter| letter.to_uppercase().to_string());
    let sentence = format!("{}{}.", first.unwrap_or_default(), letters.as_str());
    match trials.iter().find_map(|trial| trial.judged_px) {
        Some(side_px) => format!(
            "{sentence} Trials that were stopped on their way were judged by a grid of pixels of each photo, at most {side_px} \
             a side: their PSNR compares with that of others at the same step only."
        ),
        None => sentence,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture_documents::trial;

    #[test]
    fn trials_stand_by_rank_and_the_chosen_one_is_marked() {
        let shown = table(&[trial(0, 2, 30.0), trial(1, 1, 20.0)], 0).into_string();
        let place = |text: &str| shown.find(text).unwrap_or_else(|| panic!("{text}: {shown}"));
        assert!(place("20.00") < place("chosen") && place("chosen") < place("30.00"));
        assert_eq!(shown.matches("chosen").count(), 1);
    }

    #[test]
    fn the_decision_is_a_sentence_and_scores_of_other_sizes_are_told_apart() {
        let scatter = Scatter {
            psnr: [21.0, 20.6],
            best_psnr: None,
            difference_db: 0.4,
            best_minus_default_db: 0.3,
            chosen: 0,
            decision: "the defaults stay: <b>".to_owned(),
        };
        let mut trials = [trial(0, 1, 21.0), trial(1, 2, 20.5)];
        assert_eq!(decided(&scatter, &trials), "The defaults stay: <b>.");
        trials[1].judged_px = Some(128);
        assert!(decided(&scatter, &trials).contains("at most 128 a side"));
    }
}
