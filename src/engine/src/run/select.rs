//! Which nodes a run is about.

use std::collections::BTreeSet;

use super::{Options, task::Role};
use crate::{EngineError, Graph};

/// Returns the role of each node.
pub(super) fn roles(graph: &Graph, options: &Options) -> Result<Vec<Role>, EngineError> {
    let all: BTreeSet<usize> = (0..graph.nodes.len()).collect();
    let mut chosen = all.clone();
    if !options.to.is_empty() {
        let to = graph.with_ancestors(&indices(graph, &options.to)?);
        chosen.retain(|index| to.contains(index));
    }
    if !options.from.is_empty() {
        let from = graph.with_descendants(&indices(graph, &options.from)?);
        chosen.retain(|index| from.contains(index));
    }
    let needed = graph.with_ancestors(&chosen);
    let role = |index: usize| match (chosen.contains(&index), needed.contains(&index)) {
        (true, _) => Role::Run,
        (false, true) => Role::LookUp,
        (false, false) => Role::Leave,
    };
    Ok(all.into_iter().map(role).collect())
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
