//! The pipeline, its stages as tools, and the parameters of both.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Action;
use serde_json::Value;

use super::entity::{Entity, FORMAL_PARAMETER, id_of};
use super::input::GraphInput;

/// What a formal parameter is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    /// A file that is read.
    Input,
    /// A value that is set.
    Parameter,
    /// A file that is made.
    Output,
}

impl Role {
    fn word(self) -> &'static str {
        match self {
            Self::Input => "input",
            Self::Parameter => "parameter",
            Self::Output => "output",
        }
    }
}

/// The stages that ran, with all names of what they read, were set to and made.
#[derive(Debug, Default)]
pub(super) struct Tools(BTreeMap<String, Tool>);

#[derive(Debug)]
struct Tool {
    stage: String,
    version: u32,
    slots: BTreeMap<(Role, String), &'static str>,
}

impl Tools {
    pub(super) fn new(input: &GraphInput<'_>) -> Self {
        let mut tools: BTreeMap<String, Tool> = BTreeMap::new();
        for node in &input.run.nodes {
            let Some(action) = input.contents.action(node) else {
                continue;
            };
            let tool = tools.entry(tool_id(action)).or_insert_with(|| Tool {
                stage: action.stage.clone(),
                version: action.version,
                slots: BTreeMap::new(),
            });
            let inputs = action.inputs.keys();
            let inputs = inputs.map(|name| ((Role::Input, name.clone()), "File"));
            let has_origins = !input.contents.origins(node).is_empty();
            let origins = has_origins.then(|| ((Role::Input, ORIGINS.to_owned()), "File"));
            let outputs = node.run.outputs.keys();
            let outputs = outputs.map(|name| ((Role::Output, group(name).to_owned()), "File"));
            let parameters = action.params.as_object().into_iter().flatten();
            let parameters =
                parameters.map(|(name, value)| ((Role::Parameter, name.clone()), type_of(value)));
            tool.slots
                .extend(inputs.chain(origins).chain(outputs).chain(parameters));
        }
        Self(tools)
    }

    /// Returns the ids of all tools.
    pub(super) fn ids(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    pub(super) fn entities(&self) -> Vec<Value> {
        self.0.iter().flat_map(|(id, tool)| tool.entities(id)).collect()
    }
}

/// Name of the input of a source that lists the files it read.
pub(super) const ORIGINS: &str = "origins";

impl Tool {
    fn entities(&self, id: &str) -> Vec<Value> {
        let ids = |roles: &'static [Role]| {
            let slots = self.slots.keys();
            let slots = slots.filter(move |(role, _)| roles.contains(role));
            slots
                .map(|(role, name)| slot_id(id, *role, name))
                .collect::<Vec<_>>()
        };
        let tool = Entity::new(id, "SoftwareApplication")
            .with("name", format!("marf stage {}", self.stage))
            .with("softwareVersion", self.version.to_string())
            .with_ids("input", ids(&[Role::Input, Role::Parameter]))
            .with_ids("output", ids(&[Role::Output]))
            .into_value();
        let slots = self.slots.iter();
        let slots = slots.map(|((role, name), kind)| formal_parameter(slot_id(id, *role, name), name, kind));
        [tool].into_iter().chain(slots).collect()
    }
}

/// Returns the id of the tool that an action is of.
pub(crate) fn tool_id(action: &Action) -> String {
    let id = id_of("tool", &action.stage);
    format!("{id}/{}", action.version)
}

/// Returns the id of a parameter of a tool or of the pipeline.
pub(super) fn slot_id(of: &str, role: Role, name: &str) -> String {
    let word = role.word();
    let id = id_of(word, name);
    format!("{of}/{}", id.trim_start_matches('#'))
}

/// Returns the common part of outputs like `heldout/NAME.png`.
pub(super) fn group(output: &str) -> &str {
    output.split_once('/').map_or(output, |(group, _)| group)
}

pub(super) fn formal_parameter(id: String, name: &str, kind: &str) -> Value {
    Entity::new(id, "FormalParameter")
        .with("name", name)
        .with("additionalType", kind)
        .with_ids("conformsTo", [FORMAL_PARAMETER])
        .into_value()
}

fn type_of(value: &Value) -> &'static str {
    match value {
        Value::Bool(_) => "Boolean",
        Value::Number(number) if number.is_f64() => "Float",
        Value::Number(_) => "Integer",
        _ => "Text",
    }
}

/// Names of outputs of a node, by what they have in common.
pub(super) fn groups<'a>(outputs: impl Iterator<Item = &'a String>) -> BTreeSet<&'a str> {
    outputs.map(|name| group(name)).collect()
}
