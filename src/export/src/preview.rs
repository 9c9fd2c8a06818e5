//! The page for people: what the graph says, as tables.

use std::collections::BTreeMap;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;

use crate::graph::ids;

const STYLE: &str = "body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em}\
    table{border-collapse:collapse;width:100%}td,th{border-bottom:1px solid #ccc;padding:.3em .6em;text-align:left;\
    vertical-align:top}code{font-size:85%;overflow-wrap:anywhere}";

/// Entities by id.
type Entities<'a> = BTreeMap<&'a str, &'a Value>;

/// Returns the page of a graph. It opens from disk, without scripts.
pub fn preview(graph: &Value) -> String {
    let list = graph["@graph"].as_array().into_iter().flatten();
    let list: Vec<&Value> = list.collect();
    let by_id: Entities<'_> = list.iter().map(|entity| (text(entity, "@id"), *entity)).collect();
    let root = by_id.get("./").copied().unwrap_or(&Value::Null);
    let actions: Vec<&Value> = list
        .iter()
        .copied()
        .filter(|entity| is(entity, "CreateAction"))
        .collect();
    let files: Vec<&Value> = list.iter().copied().filter(|entity| is(entity, "File")).collect();
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'";
                title { (text(root, "name")) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (text(root, "name")) }
                p { (text(root, "description")) }
                p {
                    "Published " (text(root, "datePublished")) "; run root " code { (text(root, "identifier")) }
                    "; licence: " (linked(root, "license", &by_id)) "."
                }
                h2 { "What ran" }
                table {
                    tr { th { "action" } th { "by" } th { "when" } th { "from" } th { "with" } th { "to" } }
                    @for action in &actions { (action_row(action, &by_id)) }
                }
                h2 { "Files" }
                table {
                    tr { th { "file" } th { "what" } th { "bytes" } th { "SHA-256" } }
                    @for file in &files { (file_row(file)) }
                }
            }
        }
    }
    .into_string()
}

fn action_row(action: &Value, by_id: &Entities<'_>) -> Markup {
    let objects = ids(&action["object"]);
    let is_value = |id: &&str| by_id.get(id).is_some_and(|entity| is(entity, "PropertyValue"));
    let (values, inputs): (Vec<&str>, Vec<&str>) = objects.into_iter().partition(is_value);
    html! {
        tr id=(text(action, "@id").trim_start_matches('#')) {
            td { (text(action, "name")) br; small { (text(action, "description")) } }
            td { (linked(action, "instrument", by_id)) }
            td { (text(action, "startTime")) br; (text(action, "endTime")) }
            td { (links(&inputs, by_id)) }
            td {
                @for value in values.iter().filter_map(|id| by_id.get(id)) {
                    (text(value, "name")) " = " code { (text(value, "value")) } br;
                }
            }
            td { (links(&ids(&action["result"]), by_id)) }
        }
    }
}

fn file_row(file: &Value) -> Markup {
    let id = text(file, "@id");
    html! {
        tr {
            td { (link(id, id)) }
            td { (text(file, "name")) }
            td { (text(file, "contentSize")) }
            td { code { (text(file, "sha256")) } }
        }
    }
}

/// Shows what a field refers to by name.
fn linked(entity: &Value, field: &str, by_id: &Entities<'_>) -> Markup {
    let names = ids(&entity[field]).into_iter().filter_map(|id| by_id.get(id));
    html! { @for named in names { (text(named, "name")) " " (text(named, "softwareVersion")) } }
}

/// Shows the first files by name, and how many more there are.
fn links(ids: &[&str], by_id: &Entities<'_>) -> Markup {
    const SHOWN: usize = 12;
    html! {
        @for id in ids.iter().take(SHOWN) {
            (link(id, by_id.get(id).map_or(id, |entity| text(entity, "name")))) br;
        }
        @if ids.len() > SHOWN { "and " (ids.len() - SHOWN) " more" }
    }
}

/// Links a file that is in the crate, or names one that is not.
fn link(id: &str, name: &str) -> Markup {
    html! {
        @if id.contains(':') { (name) " (not included)" } @else { a href=(id) { (name) } }
    }
}

fn text<'a>(entity: &'a Value, field: &str) -> &'a str {
    entity[field].as_str().unwrap_or_default()
}

fn is(entity: &Value, kind: &str) -> bool {
    match &entity["@type"] {
        Value::Array(kinds) => kinds.iter().any(|found| found == kind),
        found => found == kind,
    }
}
