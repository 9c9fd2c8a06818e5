//! The checked pipeline: every name resolved, every parameter in range.

use std::collections::BTreeSet;
use std::path::Path;

use marf_engine::{Edge, GraphError, NodeShape};
use marf_field::Device;
use marf_schema::scenes::ScenesParams;
use marf_stage::{ParamError, Params, Port, Stage, StageDef, Table, Work};
use serde_json::Value as Json;

use super::archives::{self, Archives};
use super::error::{ConfigError, Origin};
use super::manual_lists;
use super::options::GlobalOptions;
use super::place::placed;
use super::store::{self, SharedStore};
use super::syntax::{Entry, SyntaxNode, Value};
use crate::nearest::did_you_mean;

/// A checked pipeline.
pub struct Pipeline {
    /// Name of the pipeline. Runs of one name are compared with each other.
    pub name: Option<String>,
    /// Nodes in the order of the file.
    pub nodes: Vec<Node>,
    /// The store that results are shared through.
    pub shared: Option<SharedStore>,
    /// The text with all overrides applied, as JSON.
    pub tree: Json,
}

/// A checked node.
pub struct Node {
    /// Its name, unique in the pipeline.
    pub name: String,
    /// Its stage.
    pub def: StageDef,
    /// The stage with its parameters.
    pub stage: Box<dyn Stage>,
    /// Upstream nodes, each with the key that names it.
    pub edges: Vec<Edge>,
    /// The parameters as JSON, for reports.
    pub params: Json,
}

/// Keys a whole pipeline may have.
const TOP: [&str; 7] = ["name", "archive", "node", "keep", "reject", "trade", store::TABLE];

/// Context of a node's parameters outside its own table.
struct PipelineContext<'a> {
    archives: Archives<'a>,
    device: Option<&'a Device>,
    manual_lists: Option<serde_json::Map<String, Json>>,
}

pub(super) fn check(
    root: &SyntaxNode,
    options: &GlobalOptions,
    base: &Path,
) -> Result<Pipeline, ConfigError> {
    for entry in root.entries().unwrap_or_default() {
        if !TOP.contains(&entry.key.as_str()) {
            let message = format!("unknown key `{}`", entry.key);
            return Err(ConfigError::at(entry.at.clone(), message).hint(did_you_mean(&entry.key, TOP)));
        }
    }
    check_trade(root)?;
    let shared = store::shared(root, base)?;
    let name = match root.entry("name") {
        None => None,
        Some(entry) => Some(text(entry)?.to_owned()),
    };
    let mut context = PipelineContext {
        archives: Archives::new(tables(root, ARCHIVE)?, options, base)?,
        device: options.device.as_ref(),
        manual_lists: manual_lists::lists(root)?,
    };
    let tables = tables(root, "node")?;
    let names: Vec<&str> = tables.iter().map(|entry| entry.key.as_str()).collect();
    let nodes = |context: &PipelineContext<'_>| {
        let nodes = tables.iter().map(|entry| node(entry, &names, context));
        nodes.collect::<Result<Vec<_>, _>>()
    };
    // What the nodes read decides what is measured of a photo while an archive is read.
    context.archives.measures = measures(&nodes(&context)?);
    let nodes = nodes(&context)?;
    if nodes.is_empty() {
        let hint = Some("write one with `marf init`".to_owned());
        return Err(ConfigError::at(root.at.clone(), "the pipeline has no node".to_owned()).hint(hint));
    }
    if context.manual_lists.is_some()
        && !nodes
            .iter()
            .any(|node| node.params.get(manual_lists::PARAM).is_some())
    {
        let at = root.place(
            manual_lists::LISTS
                .iter()
                .find(|list| root.entry(list).is_some())
                .unwrap_or(&""),
        );
        let message = "`[keep]` and `[reject]` overrule filters, but no node filters photos".to_owned();
        return Err(ConfigError::at(at, message));
    }
    let mut splits = nodes.iter().filter(|node| node.def.name == ScenesParams::STAGE);
    if let (Some(first), Some(second)) = (splits.next(), splits.next()) {
        let at = tables.iter().find(|entry| entry.key == second.name);
        let at = at.map_or(root.at.clone(), |entry| entry.at.clone());
        let message = format!(
            "`{}` and `{}` both split photos by place, but only one may",
            first.name, second.name
        );
        return Err(ConfigError::at(at, message));
    }
    check_graph(&nodes, tables)?;
    Ok(Pipeline {
        name,
        nodes,
        shared,
        tree: root.json(),
    })
}

/// Checks `[trade]`: keys of nodes as `--set` takes them, each with a list of values.
fn check_trade(root: &SyntaxNode) -> Result<(), ConfigError> {
    let Some(table) = root.entry("trade") else {
        return Ok(());
    };
    let refuse = |at: &Origin, message: String| {
        let hint = "write `\"train.scale\" = [1, 2, 4]` below `[trade]`".to_owned();
        Err(ConfigError::at(at.clone(), message).hint(Some(hint)))
    };
    let Some(knobs) = table.value.entries() else {
        return refuse(&table.at, "`trade` is not a table".to_owned());
    };
    for knob in knobs {
        let values = knob.value.json();
        if values.as_array().is_none_or(Vec::is_empty) || !knob.key.contains('.') {
            let message = format!(
                "`trade.{}` is not a key of a node with a list of values",
                knob.key
            );
            return refuse(&knob.at, message);
        }
    }
    Ok(())
}

/// Returns the tables of measures that some nodes read, each once.
fn measures(nodes: &[Node]) -> Vec<Table> {
    let tables = nodes.iter().flat_map(|node| match node.stage.work() {
        Work::Map(map) => map.table(),
        Work::Fold(fold) => fold.table(),
        _ => None,
    });
    let tables: BTreeSet<Table> = tables.collect();
    tables.into_iter().collect()
}

/// Returns the entries of `[key.*]`. Each must be a table.
fn tables<'a>(root: &'a SyntaxNode, key: &str) -> Result<&'a [Entry], ConfigError> {
    let Some(entry) = root.entry(key) else {
        return Ok(&[]);
    };
    let refuse = |at: &Origin, name: &str| ConfigError::at(at.clone(), format!("`{name}` is not a table"));
    let entries = entry.value.entries().ok_or_else(|| refuse(&entry.at, key))?;
    match entries.iter().find(|entry| entry.value.entries().is_none()) {
        Some(bad) => Err(refuse(&bad.at, &format!("{key}.{}", bad.key))),
        None => Ok(entries),
    }
}

/// Key of stages that read an archive.
const ARCHIVE: &str = "archive";
/// Key of stages that can run on several devices.
const DEVICE: &str = "device";

fn node(entry: &Entry, names: &[&str], context: &PipelineContext<'_>) -> Result<Node, ConfigError> {
    let table = &entry.value;
    if !is_name(&entry.key) {
        let message = format!("`{}` is not a name of a node", entry.key.escape_debug());
        let hint = "its results are in a folder of this name: use letters, digits, `-`, `_` and single dots"
            .to_owned();
        return Err(ConfigError::at(entry.at.clone(), message).hint(Some(hint)));
    }
    let def = stage_of(entry)?;
    let schema = (def.schema)();
    let keys: Vec<&str> = schema
        .get("properties")
        .and_then(Json::as_object)
        .map(|properties| properties.keys().map(String::as_str).collect())
        .unwrap_or_default();
    let ports: Vec<&str> = def.ports.iter().map(|port| port.key).collect();
    let (mut edges, mut params) = (Vec::new(), serde_json::Map::new());
    let mut archive = None;
    for field in table.entries().unwrap_or_default() {
        let key = field.key.as_str();
        if key == "uses" {
            continue;
        }
        if let Some(port) = def.ports.iter().find(|port| port.key == key) {
            edges.extend(upstreams(field, port, names)?);
        } else if key == ARCHIVE && keys.contains(&key) {
            let table = context.archives.named(field, text(field)?)?;
            params.insert(key.to_owned(), table.value.json());
            archive = Some(table);
        } else if keys.contains(&key) {
            params.insert(key.to_owned(), field.value.json());
        } else {
            let known = keys.iter().chain(&ports).copied().chain(["uses"]);
            let message = format!(
                "unknown key `{key}` in `node.{}` (stage `{}`)",
                entry.key, def.name
            );
            return Err(ConfigError::at(field.at.clone(), message).hint(did_you_mean(key, known)));
        }
    }
    if let Some(port) = def
        .ports
        .iter()
        .find(|port| port.required && !edges.iter().any(|edge: &Edge| edge.key == port.key))
    {
        let (name, key, output) = (&entry.key, port.key, port.output);
        let message = format!("`node.{name}` needs `{key} = \"…\"`, the node that gives it `{output}`");
        return Err(ConfigError::at(entry.at.clone(), message));
    }
    edges.sort_by(|a, b| a.key.cmp(&b.key));
    check_decided(entry, &def)?;
    if let Some(device) = context.device
        && keys.contains(&DEVICE)
    {
        params.entry(DEVICE).or_insert_with(|| device.to_string().into());
    }
    if let Some(lists) = &context.manual_lists
        && keys.contains(&manual_lists::PARAM)
    {
        manual_lists::add_to(&mut params, lists);
    }
    let params = Json::Object(params);
    let stage = match archive {
        Some(table) => (def.bind_archive)(params.clone(), context.archives.context(table, &entry.key)),
        None => (def.bind)(params.clone()),
    }
    .map_err(|error| param_error(entry, archive, &error))?;
    Ok(Node {
        name: entry.key.clone(),
        def,
        stage,
        edges,
        params,
    })
}

/// Returns whether a text can be the name of a node: it is the name of a folder below the output folder, and a `/` in an input leads to a
/// part of what a node gives.
fn is_name(text: &str) -> bool {
    let is_forbidden = |letter: char| matches!(letter, '/' | '\\' | ':') || letter.is_control();
    !matches!(text, "" | "." | "..") && !text.contains(is_forbidden)
}

/// Rejects a key together with an input that decides its value.
fn check_decided(entry: &Entry, def: &StageDef) -> Result<(), ConfigError> {
    let table = &entry.value;
    for port in def.ports.iter().filter(|port| table.entry(port.key).is_some()) {
        if let Some(field) = port.decides.iter().find_map(|key| table.entry(key)) {
            let (node, key, port) = (&entry.key, &field.key, port.key);
            let message = format!("node.{node}.{key}: `{port}` sets it too, and only one of them may");
            let hint = format!("remove `{key}`, or `{port}`");
            return Err(ConfigError::at(field.at.clone(), message).hint(Some(hint)));
        }
    }
    Ok(())
}

fn stage_of(entry: &Entry) -> Result<StageDef, ConfigError> {
    let (name, at) = match entry.value.entry("uses") {
        Some(uses) => (text(uses)?, &uses.value.at),
        None => (entry.key.as_str(), &entry.at),
    };
    let known = marf_stages::stages();
    known.iter().find(|def| def.name == name).copied().ok_or_else(|| {
        let hint = did_you_mean(name, known.iter().map(|def| def.name)).or_else(|| {
            Some(format!(
                "say which stage with `uses`, e.g. `uses = \"{}\"`",
                known[0].name
            ))
        });
        ConfigError::at(at.clone(), format!("unknown stage `{name}`")).hint(hint)
    })
}

fn text(entry: &Entry) -> Result<&str, ConfigError> {
    let refuse = || {
        ConfigError::at(
            entry.value.at.clone(),
            format!("`{}` must be a string", entry.key),
        )
    };
    entry.value.text().ok_or_else(refuse)
}

/// Returns the edges to the nodes that a key names: one, or each of a list where the stage takes several.
fn upstreams(field: &Entry, port: &Port, names: &[&str]) -> Result<Vec<Edge>, ConfigError> {
    let listed = match &field.value.value {
        Value::Array(listed) if port.many => listed,
        _ => return Ok(vec![upstream(&field.key, text(field)?, &field.value, names)?]),
    };
    if listed.is_empty() {
        let message = format!("`{}` names no node", field.key);
        return Err(ConfigError::at(field.value.at.clone(), message));
    }
    let edges = listed.iter().map(|one| match one.text() {
        Some(name) => upstream(&field.key, name, one, names),
        None => Err(ConfigError::at(
            one.at.clone(),
            format!("`{}` is a list of names of nodes", field.key),
        )),
    });
    edges.collect()
}

/// Returns the edge to a node, or to a part of what that node gives (`scenes/NAME`).
fn upstream(key: &str, name: &str, written: &SyntaxNode, names: &[&str]) -> Result<Edge, ConfigError> {
    let edge = Edge::new(key, name);
    if names.contains(&edge.upstream.as_str()) {
        return Ok(edge);
    }
    let message = format!("`{key} = \"{name}\"` names no node");
    let all = || Some(format!("this pipeline has {}", names.join(", ")));
    let hint = did_you_mean(name, names.iter().copied()).or_else(all);
    Err(ConfigError::at(written.at.clone(), message).hint(hint))
}

/// Puts a stage's error at the key it is about, in the node's table or in that of the archive it reads.
fn param_error(entry: &Entry, archive: Option<&Entry>, error: &ParamError) -> ConfigError {
    let in_archive = error.path.strip_prefix(ARCHIVE);
    if let (Some(table), Some(path)) = (archive, in_archive) {
        return archives::param_error(table, path.trim_start_matches('.'), error);
    }
    placed(&format!("node.{}", entry.key), entry, &error.path, &error.message)
}

/// Checks that the nodes form a graph. An error has the place of the key or the node at fault.
fn check_graph(nodes: &[Node], tables: &[Entry]) -> Result<(), ConfigError> {
    let shapes: Vec<NodeShape<'_>> = nodes
        .iter()
        .map(|node| NodeShape {
            name: &node.name,
            stage: &node.def,
            edges: &node.edges,
        })
        .collect();
    marf_engine::check(&shapes).map_err(|error| {
        let entry = tables.iter().find(|entry| entry.key == error.node);
        let at = entry.map_or(Origin::Text(0..0), |entry| match &error.key {
            Some(key) => entry.value.place(key),
            None => entry.at.clone(),
        });
        let hint = error.hint.map(str::to_owned).or_else(|| givers(&error, nodes));
        ConfigError::at(at, error.to_string()).hint(hint)
    })
}

/// Returns the hint that names what gives the output that an input lacks: nodes of the pipeline, or else stages.
fn givers(error: &GraphError, nodes: &[Node]) -> Option<String> {
    let (key, output) = (error.key.as_ref()?, error.lacks.as_ref()?);
    let own = nodes
        .iter()
        .find(|own| own.name == error.node)
        .map(|own| own.def.name);
    let gives = |def: &StageDef| Some(def.name) != own && def.outputs.contains(&output.as_str());
    let named: Vec<&str> = nodes
        .iter()
        .filter(|node| gives(&node.def))
        .map(|node| node.name.as_str())
        .collect();
    if !named.is_empty() {
        return Some(format!(
            "name a node that gives it in `{key}`: {}",
            named.join(", ")
        ));
    }
    let stages = marf_stages::stages().iter().filter(|def| gives(def));
    let stages: Vec<String> = stages.map(|def| format!("`{}`", def.name)).collect();
    (!stages.is_empty()).then(|| format!("add a node of a stage that gives it: {}", stages.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check;

    #[test]
    fn a_name_that_leads_out_of_its_folder_is_refused_and_another_is_not() {
        let error = |name: &str| {
            let text = format!(
                "[archive.demo]\nkind = \"demo\"\n[node.\"{name}\"]\nuses = \"extract\"\narchive = \"demo\"\n"
            );
            let checked = check(&text, &[], &GlobalOptions::default(), Path::new(""));
            checked.err().map(|error| error.message)
        };
        for name in [
            "", ".", "..", "a/b", "../a", "/a", "c:", r"a\\b", r"a\nb", r"a\u0000",
        ] {
            let shown = name.replace("u0000", "0");
            let expected = format!("`{shown}` is not a name of a node");
            assert_eq!(error(name), Some(expected), "{name}");
        }
        for name in ["extract", "a.b", "train@site1-20", "größe", "a b"] {
            assert_eq!(error(name), None, "{name}");
        }
    }
}
