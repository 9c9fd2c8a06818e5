//! The reference pages of the book are what the program itself says: `docs/reference/cli.md` and `docs/reference/pipeline.md`.
//!
//! `UPDATE_REFERENCE=1 cargo test --release --config tests/checks.toml --test reference` writes them.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot go on should stop; a skipped test says so"
)]

mod common;

use std::fmt::Write as _;
use std::path::Path;

use common::marf;
use serde_json::Value;

/// Compares a page of the book with what it should be, or writes it.
fn is_current(page: &str, expected: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("docs/reference")
        .join(page);
    if std::env::var_os("UPDATE_REFERENCE").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, expected).unwrap();
        return;
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    let differ = found
        .lines()
        .zip(expected.lines())
        .find(|(found, expected)| found != expected);
    assert!(
        found == expected,
        "docs/reference/{page} is out of date, first at {differ:?}: UPDATE_REFERENCE=1 writes it"
    );
}

#[test]
fn the_reference_of_the_command_line_is_current() {
    let dir = tempfile::tempdir().unwrap();
    marf(dir.path(), &["man", "pages"]).exits(0);
    let pages = std::fs::read_dir(dir.path().join("pages")).unwrap();
    let mut names: Vec<String> = pages
        .map(|page| {
            page.unwrap()
                .path()
                .file_stem()
                .unwrap()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    names.sort();
    let mut text = "# Command line\n\nThis page is generated from `--help`.\n".to_owned();
    for name in names {
        let mut words: Vec<&str> = name.split('-').skip(1).collect();
        words.push("--help");
        let help = marf(dir.path(), &words).exits(0).stdout;
        let verb = name.replace('-', " ");
        write!(text, "\n## `{verb}`\n\n```text\n{}\n```\n", help.trim_end()).unwrap();
    }
    is_current("cli.md", &text);
}

#[test]
fn the_reference_of_the_pipeline_file_is_current() {
    let schema = marf(Path::new("."), &["schema"]).exits(0).stdout;
    let schema: Value = serde_json::from_str(&schema).unwrap();
    let definitions = schema["$defs"].as_object().unwrap();
    let mut text = "# pipeline.toml\n\nThis page is generated from `marf schema`. A key without a default may be left out, except `input`.\n\nEvery node also has the key `uses`. It names the stage if the name of the node does not. Every archive has the key `kind`, which is the name of a section here.\n".to_owned();
    for title in ["Archives", "Stages"] {
        write!(text, "\n## {title}\n").unwrap();
        for (name, definition) in definitions {
            let archive = name.strip_prefix("archive.");
            if archive.is_some() == (title == "Archives") {
                add_table(&mut text, archive.unwrap_or(name), definition, definitions);
            }
        }
        let (owner, name) = if title == "Archives" {
            ("archive.pds", "network")
        } else {
            ("train", "field")
        };
        add_table(
            &mut text,
            name,
            &definitions[owner]["properties"][name],
            definitions,
        );
    }
    text += "\n## Other keys\n";
    for (name, definition) in schema["properties"].as_object().unwrap() {
        if !["archive", "node"].contains(&name.as_str()) {
            add_table(&mut text, name, definition, definitions);
        }
    }
    is_current("pipeline.md", &text);
}

/// Tables that several tables contain, and the heading under which their keys are listed.
const SHARED: [(&str, &str); 4] = [
    ("by_hand", "#keep"),
    ("field", "#field"),
    ("network", "#network"),
    ("train", "#train"),
];

/// Adds a table of the file with its keys.
fn add_table(text: &mut String, name: &str, definition: &Value, all: &serde_json::Map<String, Value>) {
    write!(text, "\n### `{name}`\n\n{}.\n", sentence(definition)).unwrap();
    let mut rows = Vec::new();
    add_rows(definition, "", all, &mut rows);
    if !rows.is_empty() {
        write!(
            text,
            "\n| key | default | meaning |\n|---|---|---|\n{}\n",
            rows.join("\n")
        )
        .unwrap();
    }
}

/// A description in one line, without its full stop.
fn one_line(definition: &Value) -> String {
    let words: Vec<&str> = definition["description"]
        .as_str()
        .unwrap_or_default()
        .split_whitespace()
        .collect();
    words.join(" ").trim_end_matches('.').replace('|', "\\|")
}

/// A description in one line, as a sentence without its full stop.
fn sentence(definition: &Value) -> String {
    let text = one_line(definition);
    let mut letters = text.chars();
    letters
        .next()
        .map(|first| first.to_uppercase().chain(letters).collect())
        .unwrap_or_default()
}

/// Adds a row for each key of a table, those of tables in it as `table.key`.
fn add_rows(table: &Value, prefix: &str, all: &serde_json::Map<String, Value>, rows: &mut Vec<String>) {
    let keys = table["properties"].as_object().into_iter().flatten();
    for (key, definition) in keys.filter(|(key, _)| !["uses", "kind"].contains(&key.as_str())) {
        let named = definition["$ref"]
            .as_str()
            .and_then(|name| all.get(name.trim_start_matches("#/$defs/")));
        let target = named.unwrap_or(definition);
        let required = table["required"]
            .as_array()
            .is_some_and(|keys| keys.iter().any(|name| name == key));
        let default = match &definition["default"] {
            Value::Null | Value::Object(_) => String::from(if required { "required" } else { "" }),
            default => format!("`{default}`"),
        };
        let meaning = [sentence(definition), sentence(target)]
            .into_iter()
            .find(|text| !text.is_empty());
        let values = values(target);
        let shared = SHARED.iter().find(|(name, _)| name == key);
        let place = shared.map_or_else(String::new, |(_, heading)| {
            format!(" Its keys are listed [here]({heading}).")
        });
        rows.push(format!(
            "| `{prefix}{key}` | {default} | {}.{values}{place} |",
            meaning.unwrap_or_default()
        ));
        if shared.is_none() && target["properties"].is_object() {
            add_rows(target, &format!("{prefix}{key}."), all, rows);
        }
    }
}

/// The values of a choice.
fn values(definition: &Value) -> String {
    let choices = definition["oneOf"].as_array().into_iter().flatten();
    let named: Vec<String> = choices
        .filter_map(|choice| Some(format!(" `{}`: {}.", choice["const"].as_str()?, one_line(choice))))
        .collect();
    named.concat()
}
