//! The nodes as a table: state, reason, time, outputs, parameters.

use maud::{Markup, html};

use super::format::{count, seconds};
use super::input::{NodeView, ReportInput, State};
use super::page::Page;

/// Says in one sentence what ran: `12 nodes: 3 ran, 9 reused, 61 s`.
pub(super) fn sentence(input: &ReportInput<'_>) -> String {
    let of = |state: State| input.nodes.iter().filter(|node| node.state == state).count();
    let states = [State::Ran, State::Reused, State::Failed, State::Skipped];
    let mut parts: Vec<String> = states
        .into_iter()
        .filter(|state| of(*state) > 0)
        .map(|state| format!("{} {}", of(state), state.word()))
        .collect();
    if let Some(total) = worked_seconds(input) {
        parts.push(seconds(total));
    }
    let nodes = format!("{}: {}", count(input.nodes.len(), "node"), parts.join(", "));
    match scenes(input) {
        Some(scenes) => format!("{nodes}; {scenes}"),
        None => nodes,
    }
}

/// Says how the scenes fared, those that are split off to pages of their own: `3 scenes: 1 ran, 2 reused`.
fn scenes(input: &ReportInput<'_>) -> Option<String> {
    let states: Vec<State> = input
        .scenes
        .iter()
        .filter_map(|scene| state_of(&scene.nodes))
        .collect();
    let of = |state: State| states.iter().filter(|one| **one == state).count();
    let known = [State::Ran, State::Reused, State::Failed, State::Skipped].into_iter();
    let parts = known.filter(|state| of(*state) > 0);
    let parts: Vec<String> = parts
        .map(|state| format!("{} {}", of(state), state.word()))
        .collect();
    (!parts.is_empty()).then(|| format!("{}: {}", count(input.scenes.len(), "scene"), parts.join(", ")))
}

/// Returns how nodes fared together: as the one that fared worst, and `ran` where any ran.
pub(super) fn state_of(nodes: &[NodeView]) -> Option<State> {
    let order = [State::Failed, State::Skipped, State::Ran, State::Reused];
    order
        .into_iter()
        .find(|state| nodes.iter().any(|node| node.state == *state))
}

/// Time of the nodes that worked in this run; what reused ones once took does not count.
fn worked_seconds(input: &ReportInput<'_>) -> Option<f64> {
    let worked = |node: &&NodeView| matches!(node.state, State::Ran | State::Failed);
    let times: Vec<f64> = input
        .nodes
        .iter()
        .filter(worked)
        .filter_map(|node| node.seconds)
        .collect();
    (!times.is_empty()).then(|| times.iter().sum())
}

/// Names every node that failed, with its message; nothing if none did.
pub(super) fn failures(input: &ReportInput<'_>) -> Markup {
    let of_scenes = input.scenes.iter().flat_map(|scene| &scene.nodes);
    let failed: Vec<&NodeView> = input
        .nodes
        .iter()
        .chain(of_scenes)
        .filter(|node| node.state == State::Failed)
        .collect();
    html! {
        @if !failed.is_empty() {
            div.alarm role="alert" {
                @for node in failed { p { strong { (node.name) " failed: " } (node.reason) } }
            }
        }
    }
}

/// Names the nodes whose outputs are of an earlier run; nothing if there are none.
pub(super) fn of_earlier_run(input: &ReportInput<'_>) -> Markup {
    let nodes = input.nodes.iter().filter(|node| node.of_run.is_some());
    let names: Vec<&str> = nodes.clone().map(|node| node.name.as_str()).collect();
    let run = nodes.filter_map(|node| node.of_run).next();
    html! {
        @if let Some(run) = run {
            p.lead { "Of run " (run) ", the last whole one, as this run has not made them: " (names.join(", ")) "." }
        }
    }
}

/// The table of nodes.
pub(super) fn body(page: &Page<'_>) -> Markup {
    html! {
        div.scroll {
            table.nodes {
                thead {
                    tr { th { "Node" } th { "State" } th.number { "Time" } th { "Why" } th { "Outputs" } }
                }
                tbody { @for node in &page.input.nodes { (row(node)) } }
            }
        }
        p.quiet { "In brackets: what a node took when it ran in an earlier run." }
    }
}

fn row(node: &NodeView) -> Markup {
    html! {
        tr {
            td.who {
                strong { (node.name) }
                @if node.stage != node.name { " " span.quiet { (node.stage) } }
                div.quiet { (node.about) }
                (params(node))
            }
            td {
                span.badge.(node.state.word()) { (node.state.word()) }
                @if let Some(run) = node.of_run { div.quiet { "outputs of run " (run) } }
            }
            td.number { (time(node)) }
            td.why { (node.reason) (children(node)) }
            td { (outputs(node)) }
        }
    }
}

/// What a reused node took when it ran stands in brackets.
fn time(node: &NodeView) -> String {
    match (node.seconds, node.state) {
        (Some(time), State::Reused | State::Skipped) => format!("({})", seconds(time)),
        (Some(time), _) => seconds(time),
        (None, _) => "–".to_owned(),
    }
}

fn params(node: &NodeView) -> Markup {
    let text = serde_json::to_string_pretty(&node.params).unwrap_or_default();
    let empty = node.params.is_null() || node.params.as_object().is_some_and(serde_json::Map::is_empty);
    html! { @if !empty { details { summary { "parameters" } pre { (text) } } } }
}

/// Up to four outputs in sight, more are folded away.
fn outputs(node: &NodeView) -> Markup {
    let list = html! {
        ul.plain {
            @for (name, digest) in &node.outputs {
                li { (name) " " code title=(digest) { (digest.short()) } }
            }
        }
    };
    html! {
        @if node.outputs.is_empty() { span.quiet { "none" } }
        @else if node.outputs.len() > 4 {
            details { summary { (count(node.outputs.len(), "output")) } (list) }
        }
        @else { (list) }
    }
}

fn children(node: &NodeView) -> Markup {
    html! {
        @if !node.children.is_empty() {
            details {
                summary { (count(node.children.len(), "sub-node")) }
                table {
                    @for child in &node.children {
                        tr {
                            td { (child.name) }
                            td { span.badge.(child.state.word()) { (child.state.word()) } }
                            td.number { (child.seconds.map_or_else(|| "–".to_owned(), seconds)) }
                        }
                    }
                }
            }
        }
    }
}
