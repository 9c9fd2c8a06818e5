//! Everything derived from a product, as text.

use marf_provenance::taint::Tainted;

/// Most outputs of a node that are named in its line.
const MOST_OUTPUTS: usize = 4;

/// Returns the nodes of a run that a product went into, and the filters that rejected it.
pub(super) fn text(tainted: &Tainted) -> Vec<String> {
    let mut lines = vec![format!("run {}: {}", tainted.run, tainted.command)];
    for node in &tainted.nodes {
        let outputs: Vec<&str> = node.outputs.keys().map(String::as_str).collect();
        let shown = outputs.len().min(MOST_OUTPUTS);
        let more = match outputs.len() - shown {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        lines.push(format!(
            "  {:<22} through {:<16} into {}{more}",
            node.node,
            node.through.join(", "),
            outputs[..shown].join(", ")
        ));
    }
    match tainted.rejected_by.as_slice() {
        [] => {}
        by => lines.push(format!(
            "  rejected by {}: what follows does not hold it",
            by.join(", ")
        )),
    }
    lines
}
