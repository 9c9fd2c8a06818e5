use std::sync::Arc;

use marf_cache::Digest;
use maud::{Markup, Render, html};

use super::input::{NodeView, ReportInput};

/// Why something is not shown, as a sentence that stands in its place.
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

/// Says that an output is there but cannot be understood.
pub(super) fn unreadable(node: &NodeView, output: &str, error: &dyn std::fmt::Display) -> Missing {
    Missing(format!(
        "{output} of {} cannot be read and is not shown: {error}.",
        node.name
    ))
}

/// Says that the store does not have an object.
pub(super) fn not_stored(what: &str, digest: &Digest) -> String {
    format!(
        "{what} is not shown: object {} is not in the store.",
        digest.short()
    )
}
