//! Changes since an earlier run, as in `marf diff`.

use maud::{Markup, html};

use super::format::count;
use super::page::Page;
use super::report::ChangedNode;

/// Lists the nodes that differ from those of the last run with other results.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let Some(changes) = &page.report.changes else {
        return html! { p { "No earlier run of this pipeline with the same archives had other results." } };
    };
    html! {
        p { "Differs from run " (changes.since) " in " (count(changes.nodes.len(), "node")) "." }
        @for node in &changes.nodes { (changed(node)) }
    }
}

fn changed(node: &ChangedNode) -> Markup {
    html! {
        @if node.lines.is_empty() {
            p.quiet { (node.heading) }
        } @else {
            details { summary { (node.heading) } ul.plain { @for line in &node.lines { li.file { (line) } } } }
        }
    }
}
