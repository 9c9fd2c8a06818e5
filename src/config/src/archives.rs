//! `[archive.*]`: each table checked against the table of kinds of archives, and the schema of the section.

use std::path::Path;

use marf_stage::{ArchiveContext, LOCK_FILE, ParamError, Table};
use marf_stages::ArchiveDef;
use serde_json::{Map, Value as Json, json};

use super::error::ConfigError;
use super::options::GlobalOptions;
use super::place::placed;
use super::syntax::{Entry, SyntaxNode};
use crate::nearest::did_you_mean;

/// Key that names the kind of an archive.
const KIND: &str = "kind";

/// The `[archive.*]` tables of a pipeline.
pub(super) struct Archives<'a> {
    tables: &'a [Entry],
    options: &'a GlobalOptions,
    /// Tables of measures that nodes of the pipeline read.
    pub(super) measures: Vec<Table>,
    folder: &'a Path,
}

impl<'a> Archives<'a> {
    /// Checks that every table has a known kind and no key that its kind does not read. Paths are relative to
    /// `folder`, the folder of the lock file.
    ///
    /// # Errors
    /// The first thing that is wrong, with its place.
    pub fn new(
        tables: &'a [Entry],
        options: &'a GlobalOptions,
        folder: &'a Path,
    ) -> Result<Self, ConfigError> {
        for table in tables {
            let def = kind_of(table)?;
            let mut schema = (def.schema)().to_value();
            // Absent where a kind has no other key.
            if let Some(properties) = schema["properties"].as_object_mut() {
                properties.insert(KIND.to_owned(), json!({}));
            }
            let owner = format!("archive.{}", table.key);
            check_keys(&table.value, &schema, &owner, &format!(" (kind `{}`)", def.kind))?;
        }
        Ok(Self {
            tables,
            options,
            measures: Vec::new(),
            folder,
        })
    }

    /// Returns the table that a node names.
    ///
    /// # Errors
    /// Returns an error if there is no table of this name.
    pub fn named(&self, field: &Entry, name: &str) -> Result<&'a Entry, ConfigError> {
        self.tables.iter().find(|table| table.key == name).ok_or_else(|| {
            let message = format!("`archive = \"{name}\"` names no `[archive.*]` table");
            let hint = did_you_mean(name, self.tables.iter().map(|table| table.key.as_str()));
            ConfigError::at(field.value.at.clone(), message).hint(hint)
        })
    }

    /// Returns the context of an archive, in addition to its table, for the node that reads it.
    pub fn context(&self, table: &Entry, node: &str) -> ArchiveContext {
        ArchiveContext {
            name: table.key.clone(),
            folder: self.folder.to_owned(),
            lock: Some(self.folder.join(LOCK_FILE)),
            access: self.options.access,
            rehash: self.options.rehash,
            measures: self.measures.clone(),
            recorded: self.options.recorded.get(node).cloned(),
        }
    }
}

/// Puts a stage's error about the archive it reads at the key of the archive's table. `path` is below the table.
pub(super) fn param_error(table: &Entry, path: &str, error: &ParamError) -> ConfigError {
    placed(&format!("archive.{}", table.key), table, path, &error.message)
}

fn kind_of(table: &Entry) -> Result<&'static ArchiveDef, ConfigError> {
    let known = marf_stages::archives();
    let words = known.iter().map(|def| def.kind);
    let list = || {
        let kinds: Vec<String> = known
            .iter()
            .map(|def| format!("{KIND} = \"{}\"", def.kind))
            .collect();
        format!("write one of {}", kinds.join(", "))
    };
    let Some(entry) = table.value.entry(KIND) else {
        let message = format!("`archive.{}` has no `{KIND}`", table.key);
        return Err(ConfigError::at(table.at.clone(), message).hint(Some(list())));
    };
    let Some(kind) = entry.value.text() else {
        let message = format!("`{KIND}` must be a string");
        return Err(ConfigError::at(entry.value.at.clone(), message).hint(Some(list())));
    };
    known.iter().find(|def| def.kind == kind).ok_or_else(|| {
        let hint = did_you_mean(kind, words).unwrap_or_else(list);
        let message = format!("unknown kind of archive `{kind}`");
        ConfigError::at(entry.value.at.clone(), message).hint(Some(hint))
    })
}

/// Refuses a key that a schema does not have, at any depth.
fn check_keys(table: &SyntaxNode, schema: &Json, owner: &str, of: &str) -> Result<(), ConfigError> {
    let Some(properties) = schema["properties"].as_object() else {
        return Ok(());
    };
    for entry in table.entries().unwrap_or_default() {
        let key = entry.key.as_str();
        let Some(inner) = properties.get(key) else {
            let message = format!("unknown key `{key}` in `{owner}`{of}");
            let hint = did_you_mean(key, properties.keys().map(String::as_str));
            return Err(ConfigError::at(entry.at.clone(), message).hint(hint));
        };
        check_keys(&entry.value, inner, &format!("{owner}.{key}"), of)?;
    }
    Ok(())
}

/// Returns the schema of the section, and adds the schema of each kind to `definitions`.
pub(super) fn schema(definitions: &mut Map<String, Json>) -> Json {
    let known = marf_stages::archives();
    let mut cases = Vec::new();
    for def in known {
        let name = format!("archive.{}", def.kind);
        definitions.insert(name.clone(), kind_schema(def));
        cases.push(json!({
            "if": {"properties": {KIND: {"const": def.kind}}},
            "then": {"$ref": format!("#/$defs/{name}")},
        }));
    }
    let kinds: Vec<&str> = known.iter().map(|def| def.kind).collect();
    json!({
        "type": "object",
        "description": "Where photos come from, by name.",
        "additionalProperties": {
            "type": "object",
            "properties": {KIND: {"enum": kinds, "description": "Kind of the archive."}},
            "required": [KIND],
            "allOf": cases,
        },
    })
}

/// Returns the keys of a kind, `kind` among them.
fn kind_schema(def: &ArchiveDef) -> Json {
    let mut schema = (def.schema)().to_value();
    let where_it_lies = if def.remote {
        " (on servers: obeys `--locked` and `--offline`, pinned in marf.lock)"
    } else {
        ""
    };
    schema["description"] = json!(format!("{}{where_it_lies}", def.about));
    schema["properties"][KIND] = json!({"const": def.kind, "description": "Kind of the archive."});
    schema["additionalProperties"] = json!(false);
    schema
}

#[cfg(test)]
mod tests {
    use super::super::{GlobalOptions, check};
    use super::*;

    /// Checks a pipeline that cannot be used. Returns place and message, and the hint.
    fn refused(text: &str) -> (String, String) {
        let error = check(text, &[], &GlobalOptions::default(), Path::new(""))
            .err()
            .unwrap();
        let hint = error.hint.clone().unwrap_or_default();
        (error.render(Path::new("p"), text), hint)
    }

    #[test]
    fn what_an_archive_does_not_read_is_refused_at_its_place_with_the_nearest_name() {
        let navcam = "mission = 'curiosity'\ninstrument = 'navcam'\nsols = 1";
        for (table, message, hint) in [
            (
                "kind = 'demo'\nsoles = 1".to_owned(),
                "p:3:1: unknown key `soles` in `archive.a` (kind `demo`)",
                "`sols`",
            ),
            (
                format!("kind = 'feed'\n{navcam}\n  network = {{ trys = 1 }}"),
                "p:6:15: unknown key `trys` in `archive.a.network`",
                "`tries`",
            ),
            (
                "kind = 'dmo'".to_owned(),
                "p:2:8: unknown kind of archive `dmo`",
                "`demo`",
            ),
            (
                "kind = 3".to_owned(),
                "p:2:8: `kind` must be a string",
                "kind = \"pds\"",
            ),
            (
                "sols = 1".to_owned(),
                "p:1:10: `archive.a` has no `kind`",
                "kind = \"folder\"",
            ),
        ] {
            // No node reads the table: it is refused all the same.
            let (said, way_out) = refused(&format!("[archive.a]\n{table}\n"));
            assert!(said.starts_with(message), "{table}: {said}");
            assert!(way_out.contains(hint), "{table}: {way_out}");
        }
    }

    #[test]
    fn what_an_archive_cannot_use_is_refused_at_its_place() {
        for (table, message) in [
            (
                "kind = 'demo'\nsols = '5..=1'",
                "p:3:8: archive.a.sols: `5..=1` is an empty range",
            ),
            (
                "kind = 'demo'\nsols = true",
                "p:3:8: archive.a.sols: expected sols like",
            ),
            ("kind = 'folder'", "p:1:10: archive.a: missing field `path`"),
            (
                "kind = 'feed'\nmission = 'ingenuity'\ninstrument = 'navcam'\nsols = 1",
                "p:4:14: archive.a.instrument: ingenuity has no navcam",
            ),
            (
                "kind = 'feed'\nmission = 'ingenuity'\ninstrument = 'helicam'\nsols = 1\nnetwork = { tries = 0 }",
                "p:6:21: archive.a.network.tries: 0 is not within 1 to 10",
            ),
        ] {
            let (said, _) = refused(&format!("[archive.a]\n{table}\n[node.extract]\narchive = 'a'\n"));
            assert!(said.starts_with(message), "{table}: {said}");
        }
    }

    #[test]
    fn an_archive_that_is_not_there_is_refused_with_the_nearest_name() {
        let (said, hint) = refused("[archive.jezero]\nkind = 'demo'\n[node.extract]\narchive = 'jezro'\n");
        assert!(
            said.contains("names no `[archive.*]` table") && hint.contains("`jezero`"),
            "{said} {hint}"
        );
    }
}
