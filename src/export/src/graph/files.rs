//! Files, and the pipeline among them.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_model::RunNode;
use serde_json::Value;

use super::context::Context;
use super::entity::{Entity, LANGUAGE, id_of};
use super::input::Described;
use super::tools::{ORIGINS, Role, formal_parameter, group, groups, slot_id, tool_id};

pub(super) fn entities(context: &Context<'_>) -> Vec<Value> {
    let examples = examples(context);
    let mut entities: Vec<Value> = Vec::new();
    for described in context.input.files {
        let examples = examples.get(&described.digest.blake3);
        let entity = file(described, examples.into_iter().flatten());
        entities.push(if described.id == context.pipeline() {
            pipeline(context, entity)
        } else {
            entity.into_value()
        });
    }
    entities.extend(pipeline_parameters(context));
    entities.extend(steps(context));
    entities
}

fn file<'a>(described: &Described<'_>, examples: impl Iterator<Item = &'a String>) -> Entity {
    let digest = &described.digest;
    Entity::new(described.id.as_str(), "File")
        .with("name", described.file.name.as_str())
        .with("encodingFormat", media_type(&described.file.path))
        .with("contentSize", digest.bytes.to_string())
        .with("sha256", digest.sha256.to_string())
        .with("blake3", digest.blake3.to_string())
        .with_ids("exampleOfWork", examples.map(String::as_str))
}

/// Returns the parameters of tools and of the pipeline that each object was.
fn examples(context: &Context<'_>) -> BTreeMap<Digest, BTreeSet<String>> {
    let mut examples: BTreeMap<Digest, BTreeSet<String>> = BTreeMap::new();
    for node in &context.run().nodes {
        let Some(action) = context.action(node) else {
            continue;
        };
        let tool = tool_id(action);
        let inputs = action
            .inputs
            .iter()
            .map(|(name, digest)| (*digest, slot_id(&tool, Role::Input, name)));
        let origins = context.origins(node).iter();
        let origins = origins.map(|digest| (*digest, slot_id(&tool, Role::Input, ORIGINS)));
        let outputs = node
            .run
            .outputs
            .iter()
            .map(|(name, output)| (output.digest, slot_id(&tool, Role::Output, group(name))));
        let ends = node
            .run
            .outputs
            .iter()
            .filter(|_| context.terminal.contains(node.run.name.as_str()));
        let ends = ends.map(|(name, output)| (output.digest, end_id(&node.run.name, group(name))));
        for (digest, slot) in inputs.chain(origins).chain(outputs).chain(ends) {
            examples.entry(digest).or_default().insert(slot);
        }
    }
    examples
}

/// Returns the id of an output of the pipeline.
fn end_id(node: &str, group: &str) -> String {
    slot_id(&id_of("pipeline", node), Role::Output, group)
}

fn ends<'a>(context: &Context<'a>) -> impl Iterator<Item = (&'a str, &'a str)> {
    let nodes = context.record().nodes.iter();
    let nodes = nodes.filter(|node| context.terminal.contains(node.name.as_str()));
    nodes.flat_map(|node| {
        let groups = groups(node.outputs.keys());
        groups.into_iter().map(|group| (node.name.as_str(), group))
    })
}

/// Makes the file that describes the pipeline the workflow of the crate.
fn pipeline(context: &Context<'_>, file: Entity) -> Value {
    let kinds = ["File", "SoftwareSourceCode", "ComputationalWorkflow", "HowTo"];
    let steps = context.record().nodes.iter();
    let outputs = ends(context).map(|(node, group)| end_id(node, group));
    file.with("@type", kinds.map(Value::from).to_vec())
        .with("name", format!("pipeline {}", context.record().pipeline))
        .with_ids("programmingLanguage", [LANGUAGE])
        .with_ids("hasPart", context.tools.ids())
        .with_ids("step", steps.map(|node| id_of("step", &node.name)))
        .with_ids("output", outputs)
        .into_value()
}

fn pipeline_parameters(context: &Context<'_>) -> Vec<Value> {
    ends(context)
        .map(|(node, group)| formal_parameter(end_id(node, group), group, "File"))
        .collect()
}

fn steps(context: &Context<'_>) -> Vec<Value> {
    let step = |position: usize, node: &RunNode| {
        let tool = context.action(node).map(tool_id);
        Entity::new(id_of("step", &node.run.name), "HowToStep")
            .with("name", node.run.name.as_str())
            .with("position", position.to_string())
            .with_ids("workExample", tool)
            .into_value()
    };
    let nodes = (1..).zip(&context.run().nodes);
    nodes.map(|(position, node)| step(position, node)).collect()
}

/// Returns the media type of a file by its ending. Sets and listings are lines of JSON.
fn media_type(path: &str) -> &'static str {
    let extension = path.rsplit_once('.').map_or("", |(_, extension)| extension);
    match extension {
        "json" => "application/json",
        "jsonl" => "application/jsonl",
        "toml" => "application/toml",
        "html" => "text/html",
        "csv" => "text/csv",
        "txt" => "text/plain",
        "png" => "image/png",
        "jpg" | "jpeg" => "image/jpeg",
        "gif" => "image/gif",
        "mp4" => "video/mp4",
        _ => "application/octet-stream",
    }
}
