//! Trials of the parameters: the best marked, and whether it is better than luck.

use maud::{Markup, html};
use serde_json::Value;

use super::input::NodeView;
use super::json;
use super::page::Page;

/// Columns that stand before the parameters.
const FIRST: [&str; 5] = ["trial", "rank", "psnr", "psnr_paper", "ssim"];

/// The table of trials of every node that has one.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let nodes: Vec<&NodeView> = page.with_output("trials").collect();
    if nodes.is_empty() {
        return page.absent("trials of parameters");
    }
    html! { @for node in nodes { h3 { (node.name) } (of_node(page, node)) } }
}

fn of_node(page: &Page<'_>, node: &NodeView) -> Markup {
    let found = match page.json::<Value>(node, "trials") {
        Ok(found) => found,
        Err(missing) => return html! { (missing) },
    };
    let listed = found.get("trials").unwrap_or(&found);
    let Some(trials) = listed.as_array() else {
        return html! { p.missing { "trials of " (node.name) " is not a list and is not shown." } };
    };
    html! {
        (luck(page, node, trials))
        (table(trials))
        @if node.outputs.contains_key("params") { (chosen(page, node)) }
    }
}

/// Best first; the order of equal trials is that of the file.
fn table(trials: &[Value]) -> Markup {
    let mut sorted: Vec<&Value> = trials.iter().collect();
    sorted.sort_by(|a, b| psnr(b).total_cmp(&psnr(a)));
    let mut columns = json::columns(trials);
    columns.sort_by_key(|column| {
        FIRST
            .iter()
            .position(|first| first == column)
            .unwrap_or(FIRST.len())
    });
    let best = best(trials);
    html! {
        div.scroll {
            table {
                thead { tr { th {} @for column in &columns { (json::head(trials, column, column.trim_start_matches("params."))) } } }
                tbody {
                    @for trial in sorted {
                        @let chosen = best.is_some_and(|best| std::ptr::eq(best, trial));
                        tr.best[chosen] {
                            td { @if chosen { strong { "chosen" } } }
                            @for column in &columns { (json::cell(trial, column)) }
                        }
                    }
                }
            }
        }
    }
}

fn psnr(trial: &Value) -> f64 {
    trial
        .get("psnr")
        .and_then(Value::as_f64)
        .unwrap_or(f64::NEG_INFINITY)
}

/// The trial of the lowest rank; without ranks the one of the highest PSNR.
fn best(trials: &[Value]) -> Option<&Value> {
    let ranked = trials
        .iter()
        .filter_map(|trial| Some((trial.get("rank")?.as_f64()?, trial)));
    let first = ranked.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, trial)| trial);
    first.or_else(|| trials.iter().max_by(|a, b| psnr(a).total_cmp(&psnr(b))))
}

/// Holds what was won against what another seed alone changes.
fn luck(page: &Page<'_>, node: &NodeView, trials: &[Value]) -> Markup {
    if !node.outputs.contains_key("scatter") {
        return html! { p.quiet { "No trial was repeated with another seed: the scatter is not known." } };
    }
    let scatter = match page.json::<Value>(node, "scatter") {
        Ok(scatter) => scatter,
        Err(missing) => return html! { (missing) },
    };
    html! {
        @match sentence(&scatter, trials) {
            Some(sentence) => p { (sentence) },
            None => (json::tables(&scatter)),
        }
    }
}

fn sentence(scatter: &Value, trials: &[Value]) -> Option<String> {
    let luck = scatter.get("difference_db")?.as_f64()?.abs();
    let won = scatter.get("best_minus_default_db")?.as_f64()?;
    let mut values: Vec<f64> = trials
        .iter()
        .map(psnr)
        .filter(|value| value.is_finite())
        .collect();
    values.sort_by(|a, b| b.total_cmp(a));
    let lead = match values[..] {
        [first, second, ..] => format!(" The first leads the second by {:.2} dB.", first - second),
        _ => String::new(),
    };
    let judged = if won > luck { "more" } else { "not more" };
    Some(format!(
        "Chosen over the defaults: {won:+.2} dB. Another seed alone changes PSNR by {luck:.2} dB: the gain is {judged} than that.{lead}"
    ))
}

fn chosen(page: &Page<'_>, node: &NodeView) -> Markup {
    match page.json::<Value>(node, "params") {
        Ok(params) => html! { details { summary { "chosen parameters" } (json::tables(&params)) } },
        Err(missing) => html! { (missing) },
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_best_trial_is_the_first_rank_or_the_highest_psnr() {
        let ranked = [json!({"rank": 2, "psnr": 30.0}), json!({"rank": 1, "psnr": 20.0})];
        assert_eq!(best(&ranked), Some(&ranked[1]));
        let plain = [json!({"psnr": 30.0}), json!({"psnr": 20.0}), json!({})];
        assert_eq!(best(&plain), Some(&plain[0]));
        assert_eq!(best(&[]), None);
    }

    #[test]
    fn a_gain_below_the_scatter_is_called_so() {
        let trials = [json!({"psnr": 21.0}), json!({"psnr": 20.5})];
        let said = |won: f64| {
            sentence(
                &json!({"difference_db": -0.4, "best_minus_default_db": won}),
                &trials,
            )
            .unwrap()
        };
        assert!(
            said(0.3).contains("not more than that. The first leads the second by 0.50 dB"),
            "{}",
            said(0.3)
        );
        assert!(said(0.5).contains("is more than that"), "{}", said(0.5));
    }
}
