//! The schema against pipelines: those that are shipped are valid, those with a typo are not.

use std::path::Path;

use super::*;
use crate::{GlobalOptions, check, syntax};

/// Keywords that only describe, and `pattern`, whose texts the stages read.
const ANNOTATIONS: [&str; 7] = [
    "$schema",
    "$defs",
    "title",
    "description",
    "default",
    "format",
    "pattern",
];

/// What of a value a schema does not allow, as `place: complaint`. Knows the keywords that our schemas use and panics
/// at any other.
fn complaints(root: &Json, schema: &Json, value: &Json, at: &str) -> Vec<String> {
    let Some(keywords) = schema.as_object() else {
        let allowed = schema.as_bool().unwrap();
        return if allowed {
            Vec::new()
        } else {
            vec![format!("{at}: nothing is allowed here")]
        };
    };
    let mut found = Vec::new();
    let inner = |schema: &Json, value: &Json| complaints(root, schema, value, at);
    for (keyword, rule) in keywords {
        let fits = |schema: &Json| inner(schema, value).is_empty();
        let list = || rule.as_array().unwrap().iter();
        let fine = match keyword.as_str() {
            word if ANNOTATIONS.contains(&word) => true,
            // Either with `if` or with `properties`.
            "then" | "additionalProperties" if keywords.contains_key("if") || !value.is_object() => true,
            "$ref" => {
                let target = root
                    .pointer(rule.as_str().unwrap().trim_start_matches('#'))
                    .unwrap();
                found.extend(inner(target, value));
                true
            }
            "allOf" => {
                list().for_each(|schema| found.extend(inner(schema, value)));
                true
            }
            "anyOf" => list().any(fits),
            "oneOf" => list().filter(|schema| fits(schema)).count() == 1,
            "not" => !fits(rule),
            "if" => {
                if fits(rule) {
                    found.extend(inner(&schema["then"], value));
                }
                true
            }
            "type" if rule.is_array() => list().any(|word| is_of(word.as_str().unwrap(), value)),
            "type" => is_of(rule.as_str().unwrap(), value),
            "enum" => list().any(|allowed| allowed == value),
            "const" => rule == value,
            "minimum" => value
                .as_f64()
                .is_none_or(|number| number >= rule.as_f64().unwrap()),
            "maximum" => value
                .as_f64()
                .is_none_or(|number| number <= rule.as_f64().unwrap()),
            "exclusiveMinimum" => value
                .as_f64()
                .is_none_or(|number| number > rule.as_f64().unwrap()),
            "minItems" => value
                .as_array()
                .is_none_or(|items| items.len() as u64 >= rule.as_u64().unwrap()),
            "maxItems" => value
                .as_array()
                .is_none_or(|items| items.len() as u64 <= rule.as_u64().unwrap()),
            "uniqueItems" => value.as_array().is_none_or(|items| {
                let repeated = |(index, item)| items[..index].contains(item);
                !items.iter().enumerate().any(repeated)
            }),
            "items" => {
                for item in value.as_array().into_iter().flatten() {
                    found.extend(inner(rule, item));
                }
                true
            }
            "required" => value
                .as_object()
                .is_none_or(|table| list().all(|key| table.contains_key(key.as_str().unwrap()))),
            "properties" | "additionalProperties" => {
                for (key, value) in value.as_object().into_iter().flatten() {
                    let known = schema["properties"].get(key);
                    let rule = if keyword == "properties" {
                        known
                    } else {
                        Some(rule).filter(|_| known.is_none())
                    };
                    found.extend(
                        rule.into_iter()
                            .flat_map(|rule| complaints(root, rule, value, &format!("{at}.{key}"))),
                    );
                }
                true
            }
            other => panic!("keyword `{other}`"),
        };
        if !fine {
            found.push(format!("{at}: {keyword} {rule} refuses {value}"));
        }
    }
    found
}

fn is_of(word: &str, value: &Json) -> bool {
    match word {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_i64() || value.is_u64(),
        "number" => value.is_number(),
        "null" => value.is_null(),
        other => panic!("type `{other}`"),
    }
}

fn refused(text: &str) -> Vec<String> {
    let schema = schema();
    complaints(&schema, &schema, &syntax::parse(text).unwrap().json(), "")
}

#[test]
fn the_shipped_pipelines_are_valid() {
    let root = &Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = std::fs::read_dir(root.join("pipelines")).unwrap();
    let mut files: Vec<_> = folder.map(|entry| entry.unwrap().path()).collect();
    files.push(root.join("pipeline.toml"));
    assert!(files.len() > 5, "{files:?}");
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        assert_eq!(refused(&text), Vec::<String>::new(), "{}", file.display());
    }
}

/// A table of each kind with all of its keys: the schema allows it, and so does the kind.
const ARCHIVES: [&str; 4] = [
    "kind = 'folder'\npath = 'photos'\nsols = 3\nrecursive = false\nkeep = 'reference'\nmax_file_mb = 100",
    "kind = 'demo'\nsols = '1..=2'\nseed = 7\nwidth = 320\nchange = 2",
    "kind = 'pds'\nmission = 'perseverance'\ninstrument = 'mastcam-z'\nsols = 'latest'\nlevel = 'edr'\npixels = 'img'\n\
     products = ['EBY']\nbase = ['https://a.example']\n\
     network = { connections = 2, delay_ms = 250, tries = 5, retry_ms = 9, stall_s = 3, relist_sols = 30, contact = 'me' }",
    "kind = 'feed'\nmission = 'curiosity'\ninstrument = 'navcam'\nsols = '1,4,7..=9'\nbase = ['https://a.example']\n\
     picture_hosts = ['https://b.example']\nnetwork = { tries = 1 }",
];

#[test]
fn every_kind_of_archive_is_in_the_schema_with_all_its_keys() {
    for table in ARCHIVES {
        let text = format!("[archive.a]\n{table}\n[node.extract]\narchive = 'a'\n");
        assert_eq!(refused(&text), Vec::<String>::new(), "{text}");
        let checked = check(&text, &[], &GlobalOptions::default(), Path::new(""));
        assert!(checked.is_ok(), "{text}: {:?}", checked.err());
    }
    for def in marf_stages::archives() {
        let schema = (def.schema)().to_value();
        let quoted = format!("'{}'", def.kind);
        let tables = ARCHIVES.iter().filter(|table| table.contains(&quoted));
        for (key, property) in schema["properties"].as_object().unwrap() {
            assert!(
                property["description"].is_string(),
                "{}: {key} is not described",
                def.kind
            );
            assert_eq!(schema["additionalProperties"], false, "{}", def.kind);
            for table in tables.clone() {
                assert!(table.contains(&format!("{key} = ")), "{}: {key}", def.kind);
            }
        }
    }
}

#[test]
fn what_a_kind_of_archive_does_not_read_is_not_valid() {
    for (table, place) in [
        ("kind = 'demo'\nsoles = '1'", ".archive.a.soles"),
        ("kind = 'demo'\npath = 'x'", ".archive.a.path"),
        ("kind = 'tape'", ".archive.a.kind"),
        ("sols = '1'", ".archive.a:"),
        ("kind = 'folder'", ".archive.a:"),
        ("kind = 'folder'\npath = 3", ".archive.a.path"),
        ("kind = 'pds'\nmission = 'perseverance'\nsols = 1", ".archive.a:"),
        (
            "kind = 'pds'\nmission = 'venera'\ninstrument = 'navcam'\nsols = 1",
            ".archive.a.mission",
        ),
        (
            "kind = 'feed'\nmission = 'curiosity'\ninstrument = 'navcam'\nsols = 1\nnetwork = { trys = 1 }",
            ".archive.a.network.trys",
        ),
        (
            "kind = 'feed'\nmission = 'curiosity'\ninstrument = 'navcam'\nsols = 1\nnetwork = { tries = 11 }",
            ".archive.a.network.tries",
        ),
    ] {
        let refused = refused(&format!("[archive.a]\n{table}\n"));
        assert!(
            refused.iter().any(|line| line.starts_with(place)),
            "{table}: {refused:#?}"
        );
    }
}

/// The schema and the program agree on the table of the shared store.
#[test]
fn a_shared_store_has_a_remote_or_no_key_and_names_at_least_one_trusted_key() {
    let remote = "remote = 'file:///shared'";
    for (store, is_valid) in [
        ("[store]".to_owned(), true),
        (format!("[store]\n{remote}"), true),
        (format!("[store]\n{remote}\ntrust = ['a.pem']"), true),
        (format!("[store]\n{remote}\ntrust = []"), false),
        (format!("store = {{ {remote}, trust = [] }}"), false),
        ("store = ['s3://b/p']".to_owned(), false),
        ("store = 3".to_owned(), false),
    ] {
        let text = format!("{store}\n[archive.demo]\nkind = 'demo'\n[node.extract]\narchive = 'demo'\n");
        let complaints = refused(&text);
        assert_eq!(complaints.is_empty(), is_valid, "{text}: {complaints:?}");
        let checked = check(&text, &[], &GlobalOptions::default(), Path::new(""));
        assert_eq!(checked.is_ok(), is_valid, "{text}: {:?}", checked.err());
    }
}

#[test]
fn what_a_stage_does_not_read_is_not_valid() {
    let refused = refused("[node.size]\ninput = 'extract'\nmin_byte = 3\n");
    assert!(
        refused.iter().any(|line| line.starts_with(".node.size.min_byte")),
        "{refused:#?}"
    );
}
