use std::sync::Arc;

use marf_cache::Digest;
use maud::{Markup, Render, html};

use super::input::{NodeView, ReportInput};

/// The sentence that stands in place of something that cannot be shown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Missing(pub(super) String);

impl Render for Missing {
    fn render(&self) -> Markup {
        html! { p.missing { (self.0) } }
    }
}

/// Reads an output of a node from the store of the input.
pub(super) fn read(input: &ReportInput<'_>, node: &NodeView, output: &str) -> Result<Arc<[u8]>, Missing> {
    let (name, outputs) = (&node.name, &node.outputs);
    let digest = outputs
        .get(output)
        .ok_or_else(|| Missing(format!("Node {name} has no output {output}.")))?;
    (input.read)(digest).ok_or_else(|| Missing(not_stored(&format!("{output} of {name}"), digest)))
}

/// Returns the sentence for an output that cannot be decoded, such as one of an older version.
pub(super) fn unreadable(node: &NodeView, output: &str, error: &dyn std::fmt::Display) -> Missing {
    Missing(format!(
        "{output} of {} cannot be read and is not shown: {error}.",
        node.name
    ))
}

/// Returns the sentence for an object that the store does not have.
pub(super) fn not_stored(what: &str, digest: &Digest) -> String {
    format!(
        "{what} is not shown: object {} is not in the store.",
        digest.short()
    )
}
