//! Actions: their bytes against their keys, the graph and the run root.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Action, Digest};
use marf_engine::{LISTING, NodeRun};
use serde_json::Value;

use super::open::{OpenCrate, text};
use crate::graph::{action_id, ids, tool_id};

/// Checks the action of every node and returns how many gave their keys.
pub(super) fn check(opened: &OpenCrate, faults: &mut Vec<String>) -> u64 {
    let by_id: BTreeMap<&str, &Value> = opened
        .entities
        .iter()
        .map(|entity| (text(entity, "@id"), entity))
        .collect();
    let digests = opened.described();
    let digests: BTreeMap<&str, Digest> = digests.into_iter().map(|(id, file)| (id, file.blake3)).collect();
    let context = Context {
        by_id,
        digests,
        known: known(opened),
    };
    let mut good = 0;
    for node in &opened.run.nodes {
        match opened.action(node) {
            Ok(action) => {
                good += 1;
                context.check_node(node, &action, faults);
            }
            Err(cause) => faults.push(format!("the action of `{}`: {cause}", node.name)),
        }
    }
    let nodes: BTreeSet<String> = opened
        .run
        .nodes
        .iter()
        .map(|node| action_id(&node.name))
        .collect();
    for entity in opened.of_type("CreateAction") {
        context.check_photo_action(entity, &nodes, faults);
    }
    good
}

struct Context<'a> {
    by_id: BTreeMap<&'a str, &'a Value>,
    digests: BTreeMap<&'a str, Digest>,
    /// Inputs and outputs of nodes, and the objects of photos.
    known: BTreeSet<Digest>,
}

/// Returns inputs and outputs of nodes, and the objects of photos.
fn known(opened: &OpenCrate) -> BTreeSet<Digest> {
    let mut known = BTreeSet::new();
    for node in &opened.run.nodes {
        known.extend(node.outputs.values().map(|output| output.digest));
        // An unreadable action is reported separately.
        known.extend(
            opened
                .action(node)
                .into_iter()
                .flat_map(|action| action.inputs.into_values()),
        );
        let rows = opened.rows(node);
        known.extend(rows.into_iter().flat_map(|row| row.blobs.into_values()));
    }
    known
}

impl Context<'_> {
    fn check_node(&self, node: &NodeRun, action: &Action, faults: &mut Vec<String>) {
        let id = action_id(&node.name);
        let Some(entity) = self.by_id.get(id.as_str()) else {
            faults.push(format!("the graph has no action of `{}`", node.name));
            return;
        };
        let mut expect = |holds: bool, what: &str| {
            if !holds {
                faults.push(format!("{what} of `{id}` in the graph is not that of the run"));
            }
        };
        expect(
            node.key
                .is_some_and(|key| text(entity, "identifier") == format!("blake3:{key}")),
            "the key",
        );
        expect(ids(&entity["instrument"]) == [tool_id(action)], "the instrument");
        let objects = ids(&entity["object"]);
        let read = self.digests_of(&objects);
        let inputs: BTreeSet<Digest> = action.inputs.values().copied().collect();
        // A source also records which files it read.
        let is_told = if action.inputs.contains_key(LISTING) {
            inputs.is_subset(&read)
        } else {
            inputs == read
        };
        expect(is_told, "what is read");
        let made: BTreeSet<Digest> = node.outputs.values().map(|output| output.digest).collect();
        expect(self.digests_of(&ids(&entity["result"])) == made, "what is made");
        expect(
            self.values_of(&objects) == params(action),
            "the set of parameters",
        );
    }

    /// Checks that an action that is of no node alone has an instrument, something read and something made, all of it of
    /// the run.
    fn check_photo_action(&self, entity: &Value, nodes: &BTreeSet<String>, faults: &mut Vec<String>) {
        let id = text(entity, "@id");
        if nodes.contains(id) {
            return;
        }
        for field in ["instrument", "object", "result"] {
            if ids(&entity[field]).is_empty() {
                faults.push(format!("`{id}` has no `{field}`"));
            }
        }
        for file in ["object", "result"].iter().flat_map(|field| ids(&entity[*field])) {
            // Files that a source read and verdicts on photos are checked with the lineage.
            let is_checked = file.starts_with("inputs/") || file.starts_with("items/");
            let digest = self.digests.get(file);
            if !is_checked && digest.is_some_and(|digest| !self.known.contains(digest)) {
                faults.push(format!("`{id}` refers to `{file}`, which no node read or made"));
            }
        }
    }

    fn digests_of(&self, ids: &[&str]) -> BTreeSet<Digest> {
        ids.iter()
            .filter_map(|id| self.digests.get(id).copied())
            .collect()
    }

    /// Returns the values of parameters among these entities, by name.
    fn values_of(&self, ids: &[&str]) -> BTreeMap<String, String> {
        let entities = ids.iter().filter_map(|id| self.by_id.get(id));
        let values = entities.filter(|entity| super::open::is(entity, "PropertyValue"));
        values
            .map(|value| (text(value, "name").to_owned(), text(value, "value").to_owned()))
            .collect()
    }
}

/// Returns the parameters of an action as the graph writes them.
fn params(action: &Action) -> BTreeMap<String, String> {
    let params = action.params.as_object().into_iter().flatten();
    params
        .map(|(name, value)| (name.clone(), crate::graph::value_text(value)))
        .collect()
}
