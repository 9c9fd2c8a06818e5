//! The checked pipeline: every name resolved, every parameter in range.

use std::collections::BTreeMap;
use std::path::Path;

use marf_engine::NodeShape;
use marf_field::Device;
use marf_stage::{ParamError, Stage, StageDef};
use serde_json::Value as Json;

use super::by_hand;
use super::error::{ConfigError, Origin};
use super::low::{Entry, Located};
use super::options::{Access, GlobalOptions};
use crate::nearest::did_you_mean;

/// A checked pipeline.
pub struct Pipeline {
    /// Name of the pipeline.
    pub name: String,
    /// Nodes in the order of the file.
    pub nodes: Vec<Node>,
}

/// A checked node.
pub struct Node {
    /// Its name, unique in the pipeline.
    pub name: String,
    /// Its stage.
    pub def: StageDef,
    /// The stage with its parameters.
    pub stage: Box<dyn Stage>,
    /// Upstream nodes by the key that names them.
    pub edges: BTreeMap<String, String>,
    /// The parameters as JSON, for reports.
    pub params: Json,
}

/// Keys a whole pipeline may have.
const TOP: [&str; 5] = ["name", "archive", "node", "keep", "reject"];

/// What nodes take from beside their own table.
struct Around<'a> {
    archives: BTreeMap<String, Json>,
    device: Option<&'a Device>,
    by_hand: Option<serde_json::Map<String, Json>>,
}

pub(super) fn check(root: &Located, options: &GlobalOptions, base: &Path) -> Result<Pipeline, ConfigError> {
    for entry in root.entries().unwrap_or_default() {
        if !TOP.contains(&entry.key.as_str()) {
            let message = format!("unknown key `{}`", entry.key);
            return Err(ConfigError::at(entry.at.clone(), message).hint(did_you_mean(&entry.key, TOP)));
        }
    }
    let name = match root.entry("name") {
        None => "marf".to_owned(),
        Some(entry) => text(entry)?.to_owned(),
    };
    let around = Around {
        archives: archives(root, options.access, base)?,
        device: options.device.as_ref(),
        by_hand: by_hand::lists(root)?,
    };
    let tables = tables(root, "node")?;
    let names: Vec<&str> = tables.iter().map(|entry| entry.key.as_str()).collect();
    let nodes = tables
        .iter()
        .map(|entry| node(entry, &names, &around))
        .collect::<Result<Vec<_>, _>>()?;
    if nodes.is_empty() {
        let hint = Some("write one with `marf init`".to_owned());
        return Err(ConfigError::at(root.at.clone(), "the pipeline has no node".to_owned()).hint(hint));
    }
    if around.by_hand.is_some() && !nodes.iter().any(|node| node.params.get(by_hand::PARAM).is_some()) {
        let at = root.place(
            by_hand::LISTS
                .iter()
                .find(|list| root.entry(list).is_some())
                .unwrap_or(&""),
        );
        let message = "`[keep]` and `[reject]` overrule filters, but no node filters photos".to_owned();
        return Err(ConfigError::at(at, message));
    }
    check_graph(&nodes, tables)?;
    Ok(Pipeline { name, nodes })
}

/// Returns the entries of `[key.*]`, each of which must be a table.
fn tables<'a>(root: &'a Located, key: &str) -> Result<&'a [Entry], ConfigError> {
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

/// Name of the lock file.
const LOCK: &str = "marf.lock";
/// Kinds of archives that lie on servers.
const REMOTE: [&str; 2] = ["pds", "feed"];
/// Key under which the program tells such an archive where it works.
const SITE: &str = "site";

/// Archives as JSON; a relative `path` is meant from the pipeline's folder.
fn archives(root: &Located, access: Access, base: &Path) -> Result<BTreeMap<String, Json>, ConfigError> {
    let mut archives = BTreeMap::new();
    for entry in tables(root, "archive")? {
        let mut json = entry.value.json();
        if let Some(Json::String(path)) = json.get_mut("path") {
            *path = base.join(&*path).to_string_lossy().into_owned();
        }
        if let Some(table) = json.as_object_mut().filter(|table| is_remote(table)) {
            let lock = base.join(LOCK);
            let site = serde_json::json!({ "name": entry.key, "lock": lock, "access": access.word() });
            table.insert(SITE.to_owned(), site);
        }
        archives.insert(entry.key.clone(), json);
    }
    Ok(archives)
}

fn is_remote(table: &serde_json::Map<String, Json>) -> bool {
    table
        .get("kind")
        .and_then(Json::as_str)
        .is_some_and(|kind| REMOTE.contains(&kind))
}

/// The parameters as people wrote them.
fn for_people(mut params: Json) -> Json {
    if let Some(Json::Object(archive)) = params.get_mut("archive") {
        archive.remove(SITE);
    }
    params
}

/// Key of stages that can run on several devices.
const DEVICE: &str = "device";

fn node(entry: &Entry, names: &[&str], around: &Around<'_>) -> Result<Node, ConfigError> {
    let table = &entry.value;
    let def = stage_of(entry)?;
    let schema = (def.schema)();
    let keys: Vec<&str> = schema
        .get("properties")
        .and_then(Json::as_object)
        .map(|properties| properties.keys().map(String::as_str).collect())
        .unwrap_or_default();
    let ports: Vec<&str> = def.ports.iter().map(|port| port.key).collect();
    let (mut edges, mut params) = (BTreeMap::new(), serde_json::Map::new());
    for field in table.entries().unwrap_or_default() {
        let key = field.key.as_str();
        if key == "uses" {
            continue;
        }
        if ports.contains(&key) {
            edges.insert(key.to_owned(), upstream(field, names)?);
        } else if key == "archive" && keys.contains(&key) {
            params.insert(key.to_owned(), archive(field, &around.archives)?);
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
        .find(|port| port.required && !edges.contains_key(port.key))
    {
        let (name, key, output) = (&entry.key, port.key, port.output);
        let message = format!("`node.{name}` needs `{key} = \"…\"`, the node that gives it `{output}`");
        return Err(ConfigError::at(entry.at.clone(), message));
    }
    if let Some(device) = around.device
        && keys.contains(&DEVICE)
    {
        params.entry(DEVICE).or_insert_with(|| device.to_string().into());
    }
    if let Some(lists) = &around.by_hand
        && keys.contains(&by_hand::PARAM)
    {
        by_hand::lay_under(&mut params, lists);
    }
    let params = Json::Object(params);
    let stage = (def.bind)(params.clone()).map_err(|error| complaint(entry, &error))?;
    Ok(Node {
        name: entry.key.clone(),
        def,
        stage,
        edges,
        params: for_people(params),
    })
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
        ConfigError::at(at.clone(), format!("there is no stage `{name}`")).hint(hint)
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

fn upstream(field: &Entry, names: &[&str]) -> Result<String, ConfigError> {
    let name = text(field)?;
    if names.contains(&name) {
        return Ok(name.to_owned());
    }
    let message = format!("`{} = \"{name}\"` names no node", field.key);
    Err(ConfigError::at(field.value.at.clone(), message).hint(did_you_mean(name, names.iter().copied())))
}

fn archive(field: &Entry, archives: &BTreeMap<String, Json>) -> Result<Json, ConfigError> {
    let name = text(field)?;
    archives.get(name).cloned().ok_or_else(|| {
        let message = format!("`archive = \"{name}\"` names no `[archive.*]` table");
        let hint = did_you_mean(name, archives.keys().map(String::as_str));
        ConfigError::at(field.value.at.clone(), message).hint(hint)
    })
}

/// Puts a stage's complaint at the key it is about.
fn complaint(entry: &Entry, error: &ParamError) -> ConfigError {
    let at = if error.path.is_empty() {
        entry.at.clone()
    } else {
        entry.value.place(&error.path)
    };
    let key = if error.path.is_empty() {
        String::new()
    } else {
        format!(".{}", error.path)
    };
    ConfigError::at(at, format!("node.{}{key}: {}", entry.key, error.message))
}

/// Checks that the nodes form a graph; an error has the place of the key or the node at fault.
fn check_graph(nodes: &[Node], tables: &[Entry]) -> Result<(), ConfigError> {
    let shapes: Vec<NodeShape<'_>> = nodes
        .iter()
        .map(|node| NodeShape {
            name: &node.name,
            stage: &node.def,
            edges: node
                .edges
                .iter()
                .map(|(key, upstream)| (key.as_str(), upstream.as_str()))
                .collect(),
        })
        .collect();
    marf_engine::check(&shapes).map_err(|error| {
        let entry = tables.iter().find(|entry| entry.key == error.node());
        let at = entry.map_or(Origin::Text(0..0), |entry| match error.key() {
            Some(key) => entry.value.place(key),
            None => entry.at.clone(),
        });
        ConfigError::at(at, error.to_string())
    })
}
