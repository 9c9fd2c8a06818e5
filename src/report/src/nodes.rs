//! The nodes as a table: state, reason, time, outputs, parameters.

use marf_engine::Outcome;
use marf_model::RunNode;
use maud::{Markup, html};

use super::format::{count, duration};
use super::json;
use super::page::Page;
use super::report::{FAILED, Report, SKIPPED, STATES, WAITING, stage, state, state_of_all};

/// Says in one sentence what ran: `Pipeline of 12 nodes: 3 ran, 9 reused, 61 s of work in 40 s`. The second time is that of the whole run.
pub(super) fn sentence(report: &Report<'_>) -> String {
    let mut parts = counts(report.nodes.iter().map(|node| state(node)));
    parts.extend(worked_s(report).map(|worked| {
        let whole = report
            .scene
            .is_none()
            .then(|| duration(report.run.record.seconds));
        let whole = whole.map_or_else(String::new, |whole| format!(" in {whole}"));
        format!("{} of work{whole}", duration(worked))
    }));
    let nodes = format!(
        "Pipeline of {}: {}",
        count(report.nodes.len(), "node"),
        parts.join(", ")
    );
    let scenes = counts(
        report
            .scenes
            .iter()
            .filter_map(|scene| state_of_all(&scene.nodes)),
    );
    if scenes.is_empty() {
        return nodes;
    }
    // Those that are split off to pages of their own: `3 scenes: 1 ran, 2 reused`.
    let number = count(report.scenes.len(), "scene");
    format!("{nodes}; {number}: {}", scenes.join(", "))
}

/// Counts states: `3 ran`, `9 reused`.
fn counts(states: impl Iterator<Item = &'static str> + Clone) -> Vec<String> {
    let number = |word: &str| states.clone().filter(|state| *state == word).count();
    let numbers = STATES.iter().map(|word| (number(word), word));
    let some = numbers.filter(|(number, _)| *number > 0);
    some.map(|(number, word)| format!("{number} {word}")).collect()
}

/// Time of the nodes that worked in this run. The earlier time of reused ones does not count.
fn worked_s(report: &Report<'_>) -> Option<f64> {
    let worked = report
        .nodes
        .iter()
        .filter(|node| ["ran", FAILED].contains(&state(node)));
    let times: Vec<f64> = worked.filter_map(|node| node.worked_s).collect();
    (!times.is_empty()).then(|| times.iter().sum())
}

/// Says how far a run is that goes on or was stopped. Empty for any other.
pub(super) fn standing(report: &Report<'_>) -> Markup {
    let record = &report.run.record;
    let of_scenes = report.scenes.iter().flat_map(|scene| &scene.nodes);
    let nodes: Vec<_> = report.nodes.iter().chain(of_scenes).collect();
    let done = nodes.iter().filter(|node| node.run.state.is_good()).count();
    let done = format!("{done} of {} done", count(nodes.len(), "node"));
    html! {
        @if record.goes_on() {
            p.standing {
                strong { "The run goes on: " (done) " after " (duration(record.seconds)) "." }
                " This page is written again as results arrive. Load it again to see them."
            }
        } @else if record.outcome == Outcome::Cancelled {
            p.standing {
                strong { "Run " (record.number) " was stopped: " (done) " after " (duration(record.seconds)) "." }
                " Results are kept. Run the same command again to continue."
            }
        }
    }
}

/// Failures that are shown with their cause. Further ones are named.
const SHOWN_FAILURES: usize = 3;

/// Names every node that failed, the first ones with message, cause and what to do. Empty if none did.
pub(super) fn failures(report: &Report<'_>) -> Markup {
    let of_scenes = report.scenes.iter().flat_map(|scene| &scene.nodes);
    let nodes = report.nodes.iter().chain(of_scenes);
    let failed: Vec<_> = nodes.copied().filter(|node| state(node) == FAILED).collect();
    html! {
        @if !failed.is_empty() {
            div.alarm role="alert" {
                @for node in failed.iter().take(SHOWN_FAILURES) {
                    p { strong { (node.run.name) " failed: " } (node.run.reason) }
                    @if let Some(cause) = &node.run.cause { p { "Cause: " (cause) } }
                    @if let Some(hint) = &node.run.hint { p { "What to do: " (hint) } }
                }
                @if failed.len() > SHOWN_FAILURES {
                    p { "Failed too: " (names(&failed[SHOWN_FAILURES..]).join(", ")) }
                }
            }
        }
    }
}

/// Names the nodes whose outputs are of an earlier run. Empty if there are none.
pub(super) fn of_earlier_run(report: &Report<'_>) -> Markup {
    let nodes = report.nodes.iter().filter(|node| node.of_run.is_some());
    let nodes: Vec<_> = nodes.copied().collect();
    let run = nodes.first().and_then(|node| node.of_run);
    html! {
        @if let Some(run) = run {
            p.lead { "Of run " (run) ", the last whole one, as this run has not made them: " (names(&nodes).join(", ")) "." }
        }
    }
}

fn names<'r>(nodes: &[&'r RunNode]) -> Vec<&'r str> {
    nodes.iter().map(|node| node.run.name.as_str()).collect()
}

/// The table of nodes.
pub(super) fn body(page: &Page<'_>) -> Markup {
    html! {
        div.scroll {
            table.nodes {
                thead {
                    tr { th { "Node" } th { "State" } th.number { "Time" } th { "Why" } th { "Outputs" } }
                }
                tbody { @for node in &page.report.nodes { (row(page.report, node)) } }
            }
        }
        p.quiet { "In brackets: what a node took when it ran in an earlier run." }
    }
}

fn row(report: &Report<'_>, node: &RunNode) -> Markup {
    html! {
        tr {
            td.who {
                strong { (node.run.name) }
                @if node.run.stage != node.run.name { " " span.quiet { (node.run.stage) } }
                div.quiet { (stage(node).map_or("", |stage| stage.about)) }
                (params(report, node))
            }
            td {
                span.badge.(state(node)) { (state(node)) }
                @if let Some(run) = node.of_run { div.quiet { "outputs of run " (run) } }
            }
            td.number { (time(node)) }
            td.why { (node.run.reason) (children(report, node)) }
            td { (outputs(node)) }
        }
    }
}

/// The earlier time of a reused node, in brackets.
fn time(node: &RunNode) -> String {
    let time = node.worked_s.map_or_else(|| "–".to_owned(), duration);
    if node.worked_s.is_some() && ["reused", SKIPPED, WAITING].contains(&state(node)) {
        return format!("({time})");
    }
    time
}

fn params(report: &Report<'_>, node: &RunNode) -> Markup {
    let params = report.params.get(&node.run.name);
    let params = params.filter(|params| params.as_object().is_none_or(|table| !table.is_empty()));
    html! { @if let Some(params) = params { (json::folded("parameters", params)) } }
}

/// Up to four outputs in sight, more are folded away.
fn outputs(node: &RunNode) -> Markup {
    let list = html! {
        ul.plain {
            @for (name, digest) in node.outputs_under("") {
                li { (name) " " code title=(digest) { (digest.short()) } }
            }
        }
    };
    html! {
        @if node.run.outputs.is_empty() { span.quiet { "none" } }
        @else if node.run.outputs.len() > 4 {
            details { summary { (count(node.run.outputs.len(), "output")) } (list) }
        }
        @else { (list) }
    }
}

fn children(report: &Report<'_>, node: &RunNode) -> Markup {
    let children: Vec<&RunNode> = report.run.children(&node.run.name).collect();
    html! {
        @if !children.is_empty() {
            details {
                summary { (count(children.len(), "sub-node")) }
                table {
                    @for child in &children {
                        tr {
                            td { (child.run.name) }
                            td { span.badge.(state(child)) { (state(child)) } }
                            td.number { (child.worked_s.map_or_else(|| "–".to_owned(), duration)) }
                        }
                    }
                }
            }
        }
    }
}
