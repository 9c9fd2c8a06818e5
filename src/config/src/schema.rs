use serde_json::{Map, Value as Json, json};

/// Returns the JSON schema of pipeline.toml, for editors.
pub fn schema() -> Json {
    let stages = marf_stages::stages();
    let names: Vec<&str> = stages.iter().map(|def| def.name).collect();
    let mut definitions = Map::new();
    let mut cases = Vec::new();
    for def in stages {
        definitions.insert(def.name.to_owned(), stage_schema(def));
        cases.push(json!({
            "if": {"properties": {"uses": {"const": def.name}}, "required": ["uses"]},
            "then": {"$ref": format!("#/$defs/{}", def.name)},
        }));
    }
    let archive = super::archives::schema(&mut definitions);
    let by_name: Map<String, Json> = names
        .iter()
        .map(|name| {
            (
                name.to_string(),
                json!({"if": {"not": {"required": ["uses"]}}, "then": {"$ref": format!("#/$defs/{name}")}}),
            )
        })
        .collect();
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "marf pipeline",
        "type": "object",
        "additionalProperties": false,
        "properties": {
            "name": {"type": "string", "description": "Name of the pipeline."},
            "keep": super::manual_lists::schema("keeps"),
            "reject": super::manual_lists::schema("rejects"),
            "trade": {
                "type": "object",
                "description": "Values that `marf trade` tries, by the key of a node in quotes (`\"train.scale\" = [1, 2, 4]`).",
                "additionalProperties": {"type": "array", "minItems": 1},
            },
            "store": super::store::schema(),
            "tune": {
                "type": "boolean",
                "default": true,
                "description": "Whether nodes of the stage `tune` choose parameters. `false` leaves these nodes out, and trainings use their own.",
            },
            "archive": archive,
            "node": {
                "type": "object",
                "description": "A node's stage is its name, or `uses`.",
                "properties": by_name,
                "additionalProperties": {"type": "object", "properties": {"uses": {"enum": names}}, "allOf": cases},
            },
        },
        "$defs": definitions,
    })
}

/// Returns the stage's parameters, its ports (each names a node) and `uses`.
fn stage_schema(def: &marf_stage::StageDef) -> Json {
    let mut schema: Json = (def.schema)().to_value();
    schema["description"] = json!(def.about);
    if !schema["properties"].is_object() {
        schema["properties"] = json!({});
    }
    schema["properties"]["uses"] = json!({"const": def.name});
    for port in def.ports {
        schema["properties"][port.key] = if port.many {
            json!({
                "type": ["string", "array"],
                "items": {"type": "string"},
                "minItems": 1,
                "description": format!("Nodes that give `{}`.", port.output),
            })
        } else {
            json!({"type": "string", "description": format!("Node that gives `{}`.", port.output)})
        };
    }
    schema["additionalProperties"] = json!(false);
    schema
}

#[cfg(test)]
mod tests;
