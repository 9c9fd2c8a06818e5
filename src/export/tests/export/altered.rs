//! Altered crates: every kind of file, in one bit, also with a new bag.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use marf_engine::Cancel;
use marf_export::CrateOptions;
use marf_export::Photos;
use marf_export::verify::{OpenError, verify};

use super::fixture::{check, edit_graph, entity, options, public_key, rebag, signing_key, world};

/// A signed crate with chosen photos: it has every kind of file.
fn full(dir: &Path) -> PathBuf {
    let key = signing_key();
    let all = CrateOptions {
        photos: Photos::Chosen(vec!["a".to_owned()]),
        key: Some(&key),
        ..options()
    };
    world().write(dir, &all)
}

/// One file of each kind: the first in each folder, with its ending.
fn kinds(folder: &Path) -> BTreeMap<String, PathBuf> {
    let mut kinds = BTreeMap::new();
    for entry in walkdir::WalkDir::new(folder).sort_by_file_name() {
        let path = entry.unwrap().into_path();
        if path.is_file() {
            let below = path.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
            let kind = match below.split('/').collect::<Vec<_>>()[..] {
                ["data", file] => file.to_owned(),
                ["data", folder, ..] => folder.to_owned(),
                _ => below,
            };
            kinds.entry(kind).or_insert(path);
        }
    }
    kinds
}

#[test]
fn one_bit_in_any_kind_of_file_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let folder = full(dir.path());
    let kinds = kinds(&folder);
    let names: Vec<&str> = kinds.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "actions",
            "attestation.dsse.json",
            "bag-info.txt",
            "bagit.txt",
            "inputs",
            "items",
            "manifest-sha256.txt",
            "objects",
            "outputs",
            "pipeline.toml",
            "ro-crate-metadata.json",
            "run.json",
            "tagmanifest-sha256.txt",
        ]
    );
    for (kind, path) in kinds {
        let whole = std::fs::read(&path).unwrap();
        for place in [0, whole.len() / 2, whole.len() - 1] {
            let mut bytes = whole.clone();
            bytes[place] ^= 1;
            std::fs::write(&path, &bytes).unwrap();
            // A graph or a root that cannot be read is an error instead.
            let found = verify(&folder, None, &Cancel::default());
            let said = match &found {
                Ok(report) => report.faults.join("; "),
                Err(error) => error.to_string(),
            };
            assert!(!said.is_empty(), "{kind}, byte {place}");
            let sentence = match kind.as_str() {
                "bagit.txt" => "`bagit.txt` does not declare a bag of version 1.0".to_owned(),
                "run.json" if place == 0 => format!("the run root of {}: ", folder.display()),
                _ => continue,
            };
            assert!(said.contains(&sentence), "{kind}: {said}");
        }
        std::fs::write(&path, &whole).unwrap();
    }
    assert_eq!(check(&folder).faults, Vec::<String>::new());
}

/// A change with a new bag is found by the graph, by an action or by the signature.
#[test]
fn one_bit_under_a_new_manifest_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let folder = full(dir.path());
    for (kind, path) in kinds(&folder) {
        if !path.starts_with(folder.join("data")) {
            continue;
        }
        let whole = std::fs::read(&path).unwrap();
        let mut bytes = whole.clone();
        let place = bytes.len() / 2;
        bytes[place] ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        rebag(&folder);
        let key = public_key();
        let found =
            |key| verify(&folder, key, &Cancel::default()).map_or(true, |report| !report.faults.is_empty());
        assert!(found(Some(&key)), "{kind}, with the key");
        // The page is for people, and a name in the graph is a name: only the signature protects them.
        let is_protected = !kind.starts_with("ro-crate-");
        assert!(found(None) || !is_protected, "{kind}, without a key");
        std::fs::write(&path, &whole).unwrap();
        rebag(&folder);
    }
    assert_eq!(
        verify(&folder, Some(&public_key()), &Cancel::default())
            .unwrap()
            .faults,
        Vec::<String>::new()
    );
}

#[test]
fn a_graph_that_was_edited_is_found() {
    type Edit = fn(&mut Vec<serde_json::Value>);
    let cases: [(Edit, &str); 10] = [
        (
            |graph| {
                drop(
                    entity(graph, "#action/size")
                        .as_object_mut()
                        .unwrap()
                        .remove("instrument"),
                )
            },
            "the instrument of `#action/size` in the graph is not that of the run",
        ),
        (
            |graph| entity(graph, "#action/size")["object"][0]["@id"] = "#nobody".into(),
            "`object` of `#action/size` refers to `#nobody`, which is not in the graph",
        ),
        (
            |graph| entity(graph, "#action/fit")["result"][0]["@id"] = "outputs/nothing.bin".into(),
            "`result` of `#action/fit` refers to `outputs/nothing.bin`, which is not in the graph",
        ),
        (
            |graph| graph.retain(|entity| entity["@id"] != "#control/fit"),
            "`object` of `#marf/run` refers to `#control/fit`, which is not in the graph",
        ),
        (
            |graph| graph.retain(|entity| entity["@id"] != "outputs/fit/weights.bin"),
            "the graph does not describe `outputs/fit/weights.bin`",
        ),
        (
            |graph| entity(graph, "#value/fit/parameter/seed")["value"] = "9".into(),
            "the set of parameters of `#action/fit` in the graph is not that of the run",
        ),
        (
            |graph| entity(graph, "#action/fit")["identifier"] = "blake3:0".into(),
            "the key of `#action/fit` in the graph is not that of the run",
        ),
        (
            |graph| entity(graph, "outputs/fit/weights.bin")["sha256"] = "0".repeat(64).into(),
            "`outputs/fit/weights.bin` has another length or digest than the graph gives",
        ),
        (
            |graph| {
                let action = entity(graph, "#control/fit").clone();
                entity(graph, "#run")["result"] =
                    serde_json::json!([{"@id": "pipeline.toml"}, {"@id": action["@id"]}]);
            },
            "`#run` refers to `pipeline.toml`, which no node read or made",
        ),
        (
            |graph| {
                let twice = entity(graph, "#marf").clone();
                graph.push(twice);
            },
            "the graph has no id or two entities `#marf`",
        ),
    ];
    for (edit, expected) in cases {
        let dir = tempfile::tempdir().unwrap();
        let folder = world().write(dir.path(), &options());
        edit_graph(&folder, edit);
        let faults = check(&folder).faults;
        assert!(
            faults.iter().any(|fault| fault == expected),
            "{expected}: {faults:#?}"
        );
    }
}

#[test]
fn a_file_that_was_taken_out_is_found() {
    let dir = tempfile::tempdir().unwrap();
    let folder = world().write(dir.path(), &options());
    std::fs::remove_file(folder.join("data/outputs/fit/weights.bin")).unwrap();
    assert_eq!(check(&folder).faults.len(), 3, "manifest, count, graph");
    rebag(&folder);
    assert_eq!(
        check(&folder).faults,
        ["the graph describes `outputs/fit/weights.bin`, which is not in the bag"]
    );
}

#[test]
fn a_newer_crate_and_a_stranger_s_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let folder = world().write(dir.path(), &options());
    let path = folder.join("data/ro-crate-metadata.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("urn:x-marf:crate:1", "urn:x-marf:crate:2")).unwrap();
    let error = verify(&folder, None, &Cancel::default()).unwrap_err();
    assert!(
        matches!(&error, OpenError::Newer { found, .. } if found == "2"),
        "{error}"
    );
    std::fs::write(&path, text.replace("urn:x-marf:crate:1", "urn:other")).unwrap();
    assert!(matches!(
        verify(&folder, None, &Cancel::default()),
        Err(OpenError::Foreign { .. })
    ));
    assert!(matches!(
        verify(dir.path(), None, &Cancel::default()),
        Err(OpenError::NoCrate { .. })
    ));
}
