//! Trials of the parameters: the best marked, and its gain beside what another seed alone changes.

use marf_schema::tune::{BestParams, Scatter, Trial, Trials};
use maud::{Markup, html};
use serde_json::Value;

use super::format::{decibels, similarity};
use super::input::NodeView;
use super::json;
use super::page::Page;

/// Columns before the parameters, in the order of [`scores`].
const SCORES: [&str; 5] = ["trial", "rank", "psnr", "psnr_paper", "ssim"];

/// The table of trials of every node that has one.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let nodes: Vec<&NodeView> = page.with_document::<Trials>().collect();
    if nodes.is_empty() {
        return page.absent("trials of parameters");
    }
    html! { @for node in nodes { h3 { (node.name) } (of_node(page, node)) } }
}

fn of_node(page: &Page<'_>, node: &NodeView) -> Markup {
    let trials = match page.document(node) {
        Ok(Trials(trials)) => trials,
        Err(missing) => return html! { (missing) },
    };
    html! {
        @match page.document::<Scatter>(node) {
            Ok(scatter) => p { (gain(&scatter, &trials)) },
            Err(missing) => (missing),
        }
        (table(&trials))
        @match page.document::<BestParams>(node) {
            Ok(params) => details { summary { "chosen parameters" } (json::fields(&params)) },
            Err(missing) => (missing),
        }
    }
}

/// Best first; the order of equal trials is that of the file.
fn table(trials: &[Trial]) -> Markup {
    let mut sorted: Vec<(&Trial, Value)> = trials
        .iter()
        .map(|trial| (trial, json::value(&trial.params)))
        .collect();
    let params: Vec<Value> = sorted.iter().map(|(_, params)| params.clone()).collect();
    sorted.sort_by(|(a, _), (b, _)| b.psnr.total_cmp(&a.psnr));
    let columns = json::columns(&params);
    html! {
        div.scroll {
            table {
                thead { tr {
                    th {}
                    @for name in SCORES { th.number { (name) } }
                    @for column in &columns { (json::head(&params, column, column)) }
                } }
                tbody {
                    @for (trial, params) in sorted {
                        @let best = trial.rank == 1;
                        tr.best[best] {
                            td { @if best { strong { "chosen" } } }
                            @for score in scores(trial) { td.number { (score) } }
                            @for column in &columns { (json::cell(&params, column)) }
                        }
                    }
                }
            }
        }
    }
}

fn scores(trial: &Trial) -> [String; 5] {
    let known = |value: Option<f64>, text: fn(f64) -> String| value.map_or_else(|| "–".to_owned(), text);
    [
        trial.trial.to_string(),
        trial.rank.to_string(),
        decibels(trial.psnr),
        known(trial.psnr_paper, decibels),
        known(trial.ssim, similarity),
    ]
}

/// Says what the best trial gained, and whether that is more than another seed alone changes.
fn gain(scatter: &Scatter, trials: &[Trial]) -> String {
    let (noise, gain) = (scatter.difference_db.abs(), scatter.best_minus_default_db);
    let mut values: Vec<f64> = trials.iter().map(|trial| trial.psnr).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    let lead = match values[..] {
        [first, second, ..] => format!(" The first leads the second by {:.2} dB.", first - second),
        _ => String::new(),
    };
    let judged = if gain > noise { "more" } else { "not more" };
    format!(
        "Chosen over the defaults: {gain:+.2} dB. Another seed alone changes PSNR by {noise:.2} dB: the gain is {judged} than that.{lead}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::show::fixture_documents::trial;

    #[test]
    fn the_first_rank_is_marked_and_the_highest_psnr_stands_first() {
        let shown = table(&[trial(0, 2, 30.0), trial(1, 1, 20.0)]).into_string();
        let place = |text: &str| shown.find(text).unwrap_or_else(|| panic!("{text}: {shown}"));
        assert!(place("30.00") < place("chosen") && place("chosen") < place("20.00"));
        assert_eq!(shown.matches("chosen").count(), 1);
    }

    #[test]
    fn a_gain_below_the_scatter_is_called_so() {
        let trials = [trial(0, 1, 21.0), trial(1, 2, 20.5)];
        let said = |best_minus_default_db: f64| {
            let scatter = Scatter {
                psnr: [21.0, 20.6],
                difference_db: 0.4,
                best_minus_default_db,
            };
            gain(&scatter, &trials)
        };
        assert!(
            said(0.3).contains("not more than that. The first leads the second by 0.50 dB"),
            "{}",
            said(0.3)
        );
        assert!(said(0.5).contains("is more than that"), "{}", said(0.5));
    }
}
