use std::sync::Arc;

use marf_cache::Digest;
use marf_model::RunNode;
use maud::{Markup, Render, html};

use super::report::Report;

/// The sentence shown instead of an unavailable object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Missing(pub(super) String);

impl Render for Missing {
    fn render(&self) -> Markup {
        html! { p.missing { (self.0) } }
    }
}

/// Reads an output of a node from the store of the report.
pub(super) fn read(report: &Report<'_>, node: &RunNode, output: &str) -> Result<Arc<[u8]>, Missing> {
    let name = &node.run.name;
    let digest = node
        .digest(output)
        .ok_or_else(|| Missing(format!("Node {name} has no output {output}.")))?;
    (report.read)(digest).ok_or_else(|| Missing(not_stored(&format!("{output} of {name}"), digest)))
}

/// Returns the sentence for an output that cannot be decoded, such as one of an older version.
pub(super) fn unreadable(node: &RunNode, output: &str, error: &dyn std::fmt::Display) -> Missing {
    Missing(format!(
        "{output} of {} cannot be read and is not shown: {error}.",
        node.run.name
    ))
}

/// Returns the sentence for an object that the store does not have.
pub(super) fn not_stored(what: &str, digest: &Digest) -> String {
    format!(
        "{what} is not shown: object {} is not in the store.",
        digest.short()
    )
}
