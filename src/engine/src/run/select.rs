//! Which nodes a run is about.

use std::collections::BTreeSet;

use super::{Options, task::Role};
use crate::{EngineError, Graph};

impl Graph {
    /// Returns the names of what leads to one of `to` and follows from one of `from`; an empty list does not limit.
    ///
    /// # Errors
    /// Names a node that is not there.
    pub fn select(&self, to: &[String], from: &[String]) -> Result<BTreeSet<String>, EngineError> {
        Ok(chosen(self, to, from)?
            .into_iter()
            .map(|index| self.nodes[index].name.clone())
            .collect())
    }
}

fn chosen(graph: &Graph, to: &[String], from: &[String]) -> Result<BTreeSet<usize>, EngineError> {
    let mut chosen: BTreeSet<usize> = (0..graph.nodes.len()).collect();
    if !to.is_empty() {
        let to = graph.with_ancestors(&indices(graph, to)?);
        chosen.retain(|index| to.contains(index));
    }
    if !from.is_empty() {
        let from = graph.with_descendants(&indices(graph, from)?);
        chosen.retain(|index| from.contains(index));
    }
    Ok(chosen)
}

/// Returns the role of each node.
pub(super) fn roles(graph: &Graph, options: &Options) -> Result<Vec<Role>, EngineError> {
    let chosen = chosen(graph, &options.to, &options.from)?;
    let needed = graph.with_ancestors(&chosen);
    let role = |index: usize| match (chosen.contains(&index), needed.contains(&index)) {
        (true, _) => Role::Run,
        (false, true) => Role::LookUp,
        (false, false) => Role::Leave,
    };
    Ok((0..graph.nodes.len()).map(role).collect())
}

fn indices(graph: &Graph, names: &[String]) -> Result<BTreeSet<usize>, EngineError> {
    let find = |name: &String| {
        graph.index(name).ok_or_else(|| EngineError::UnknownNode {
            node: name.clone(),
            known: graph.names().into_iter().map(str::to_owned).collect(),
        })
    };
    names.iter().map(find).collect()
}
