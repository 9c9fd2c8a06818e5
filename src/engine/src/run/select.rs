//! Selection of the nodes of a run.

use std::collections::BTreeSet;

use super::task::Role;
use crate::{graph::Graph, record::EngineError};

impl Graph {
    /// Returns the names of the nodes that a node of `to` depends on and that depend on a node of `from`, including these nodes. An empty
    /// list does not limit the selection.
    ///
    /// # Errors
    /// A name that is not in the graph.
    pub fn select(&self, to: &[String], from: &[String]) -> Result<BTreeSet<String>, EngineError> {
        Ok(selected(self, to, from)?
            .into_iter()
            .map(|index| self.nodes[index].name.clone())
            .collect())
    }
}

/// Returns the indices of the selected nodes.
fn selected(graph: &Graph, to: &[String], from: &[String]) -> Result<BTreeSet<usize>, EngineError> {
    let mut selected: BTreeSet<usize> = (0..graph.nodes.len()).collect();
    if !to.is_empty() {
        let to = graph.with_ancestors(&indices(graph, to)?);
        selected.retain(|index| to.contains(index));
    }
    if !from.is_empty() {
        let from = graph.with_descendants(&indices(graph, from)?);
        selected.retain(|index| from.contains(index));
    }
    Ok(selected)
}

/// Returns the role of each node in a run limited by `to` and `from`.
pub(super) fn roles(graph: &Graph, to: &[String], from: &[String]) -> Result<Vec<Role>, EngineError> {
    let selected = selected(graph, to, from)?;
    let needed = graph.with_ancestors(&selected);
    let role = |index: usize| match (selected.contains(&index), needed.contains(&index)) {
        (true, _) => Role::Run,
        (false, true) => Role::LookUp,
        (false, false) => Role::Ignore,
    };
    Ok((0..graph.nodes.len()).map(role).collect())
}

/// Returns the indices of the named nodes.
pub(super) fn indices(graph: &Graph, names: &[String]) -> Result<BTreeSet<usize>, EngineError> {
    let find = |name: &String| graph.index(name).ok_or_else(|| EngineError::unknown(graph, name));
    names.iter().map(find).collect()
}
