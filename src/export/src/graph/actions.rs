//! Actions: the run, each node, and each decision on a chosen photo.

use marf_model::RunNode;
use serde_json::Value;

use super::context::Context;
use super::entity::{Entity, PROGRAM, id_of};
use super::tools::{Role, slot_id, tool_id};
use crate::contents::ItemVerdict;
use crate::time::{end_of, known_time};

pub(super) fn entities(context: &Context<'_>) -> Vec<Value> {
    let run = context.run();
    let mut entities = vec![run_action(context), organize(context)];
    for node in &run.nodes {
        let name = &node.run.name;
        entities.push(node_action(context, node));
        entities.push(control(&action_id(name), name));
        entities.extend(values(context, node));
    }
    for item in &context.input.contents.items {
        entities.push(item_action(context, item));
        entities.push(control(&item_id(item), &item.node));
    }
    entities
}

/// Returns the id of the action of a node.
pub(crate) fn action_id(node: &str) -> String {
    id_of("action", node)
}

/// Returns the id of the decision of a node on a photo.
pub(super) fn item_id(item: &ItemVerdict) -> String {
    format!("{}/photo/{}", action_id(&item.node), file_stem(&item.path))
}

/// Returns the path of a verdict's file without folder `items/` and ending: unique, and plain by construction.
fn file_stem(path: &str) -> &str {
    let stem = path.strip_prefix("items/").unwrap_or(path);
    stem.strip_suffix(".json").unwrap_or(stem)
}

fn run_action(context: &Context<'_>) -> Value {
    let run = context.record();
    let nodes = context.run().nodes.iter();
    let inputs = nodes.clone().flat_map(|node| foreign_inputs(context, node));
    let results = nodes.filter(|node| context.terminal.contains(node.run.name.as_str()));
    let results = results.flat_map(|node| node.run.outputs.values());
    let results = results.filter_map(|output| context.ids.get(&output.digest).copied());
    Entity::new("#run", "CreateAction")
        .with("name", format!("run {}", run.id))
        .with("description", run.command.as_str())
        .with_ids("instrument", [context.pipeline()])
        .with_ids("object", once(inputs))
        .with_ids("result", once(results))
        .with("startTime", known_time(run.started_unix_s))
        .with("endTime", known_time(end_of(run.started_unix_s, run.seconds)))
        .into_value()
}

/// Returns the ids of what a node read and no node of the run made.
fn foreign_inputs<'a>(context: &Context<'a>, node: &'a RunNode) -> Vec<&'a str> {
    let made = |digest: &marf_cache::Digest| {
        let nodes = context.record().nodes.iter();
        let mut outputs = nodes.flat_map(|node| node.outputs.values());
        outputs.any(|output| output.digest == *digest)
    };
    let inputs = context
        .action(node)
        .into_iter()
        .flat_map(|action| action.inputs.values());
    let inputs = inputs.chain(context.origins(node)).filter(|digest| !made(digest));
    inputs
        .filter_map(|digest| context.ids.get(digest).copied())
        .collect()
}

fn organize(context: &Context<'_>) -> Value {
    let run = context.record();
    let nodes = run.nodes.iter().map(|node| control_id(&action_id(&node.name)));
    let items = context.input.contents.items.iter();
    let items = items.map(|item| control_id(&item_id(item)));
    Entity::new("#marf/run", "OrganizeAction")
        .with("name", format!("marf runs {}", run.id))
        .with_ids("instrument", [PROGRAM])
        .with_ids("object", nodes.chain(items))
        .with_ids("result", ["#run"])
        .with("startTime", known_time(run.started_unix_s))
        .with("endTime", known_time(end_of(run.started_unix_s, run.seconds)))
        .into_value()
}

fn control_id(action: &str) -> String {
    format!("#control{}", action.trim_start_matches("#action"))
}

fn control(action: &str, node: &str) -> Value {
    Entity::new(control_id(action), "ControlAction")
        .with("name", format!("step {node}"))
        .with_ids("instrument", [id_of("step", node)])
        .with_ids("object", [action])
        .into_value()
}

fn node_action(context: &Context<'_>, node: &RunNode) -> Value {
    let action = context.action(node);
    let inputs = inputs(context, node).map(str::to_owned);
    let results = node.run.outputs.values();
    let results = results.filter_map(|output| context.ids.get(&output.digest).copied());
    let key = node.run.key;
    let action_file = key.and_then(|key| context.ids.get(&key).copied());
    let name = node.run.name.as_str();
    let entity = Entity::new(action_id(name), "CreateAction")
        .with("name", name)
        .with("identifier", key.map(|key| format!("blake3:{key}")))
        .with_ids("subjectOf", action_file)
        .with_ids("instrument", action.map(tool_id))
        .with_ids("object", inputs.chain(value_ids(context, node)))
        .with_ids("result", once(results));
    with_times(entity, context, node).into_value()
}

/// Adds when, where and by which program the result was made, as far as it is known.
fn with_times(entity: Entity, context: &Context<'_>, node: &RunNode) -> Entity {
    let Some(started) = node.run.started_unix_s else {
        return entity;
    };
    let ended = end_of(started, node.run.seconds);
    let when = if ended < context.record().started_unix_s {
        "an earlier run, whose result was used again"
    } else {
        "this run"
    };
    let by = node.made_by();
    let by = by.as_deref().unwrap_or("a program that left no name");
    entity
        .with("description", format!("made by {by} in {when}"))
        .with("startTime", known_time(started))
        .with("endTime", known_time(ended))
}

/// Returns the parameters of a node with the ids of their values.
fn parameters<'a>(
    context: &Context<'a>,
    node: &'a RunNode,
) -> impl Iterator<Item = (String, &'a str, &'a Value)> {
    let values = id_of("value", &node.run.name);
    let action = context.action(node);
    let params = action.and_then(|action| action.params.as_object());
    params
        .into_iter()
        .flatten()
        .map(move |(name, value)| (slot_id(&values, Role::Parameter, name), name.as_str(), value))
}

fn value_ids<'a>(context: &Context<'a>, node: &'a RunNode) -> impl Iterator<Item = String> + use<'a> {
    parameters(context, node)
        .map(|(id, ..)| id)
        .collect::<Vec<_>>()
        .into_iter()
}

fn values(context: &Context<'_>, node: &RunNode) -> Vec<Value> {
    let tool = context.action(node).map(tool_id).unwrap_or_default();
    let value = |(id, name, value): (String, &str, &Value)| {
        Entity::new(id, "PropertyValue")
            .with("name", name)
            .with("value", value_text(value))
            .with_ids("exampleOfWork", [slot_id(&tool, Role::Parameter, name)])
            .into_value()
    };
    parameters(context, node).map(value).collect()
}

/// Returns a parameter's value as text: a text as it is, anything else as canonical JSON.
pub(crate) fn value_text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => String::from_utf8_lossy(&marf_cache::canonical_json(other)).into_owned(),
    }
}

fn item_action(context: &Context<'_>, item: &ItemVerdict) -> Value {
    let node = context.run().node(&item.node);
    let verdict = context.by_path.get(item.path.as_str()).copied();
    let blobs = item.blobs.values();
    let blobs: Vec<&str> = blobs
        .filter_map(|digest| context.ids.get(digest).copied())
        .collect();
    let (read, made) = if item.is_source {
        (Vec::new(), blobs)
    } else {
        (blobs, Vec::new())
    };
    // Decisions may compare a photo with its whole set, which is among the inputs of the node.
    let inputs = node.into_iter().flat_map(|node| inputs(context, node));
    let objects = read.into_iter().chain(inputs).map(str::to_owned);
    let values = node.into_iter().flat_map(|node| value_ids(context, node));
    let tool = node.and_then(|node| context.action(node)).map(tool_id);
    Entity::new(item_id(item), "CreateAction")
        .with("name", format!("{} of {}", item.node, item.id))
        .with_ids("instrument", tool)
        .with_ids("object", objects.chain(values))
        .with_ids("result", made.into_iter().chain(verdict))
        .into_value()
}

/// Returns the ids of what a node read.
fn inputs<'a>(context: &Context<'a>, node: &'a RunNode) -> impl Iterator<Item = &'a str> + use<'a> {
    let inputs = context
        .action(node)
        .into_iter()
        .flat_map(|action| action.inputs.values());
    let inputs = inputs.chain(context.origins(node));
    let ids: Vec<&str> = inputs
        .filter_map(|digest| context.ids.get(digest).copied())
        .collect();
    ids.into_iter()
}

/// Returns each id once, in the order of the first.
fn once<'a>(ids: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut seen = std::collections::BTreeSet::new();
    ids.filter(|id| seen.insert(*id)).collect()
}
