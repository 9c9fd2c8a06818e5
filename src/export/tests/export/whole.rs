//! Crates that hold.

use std::collections::BTreeMap;
use std::path::Path;

use marf_cache::{Digest, Sha256};
use marf_engine::Cancel;
use marf_export::verify::{OpenCrate, Role, Signature, verify};
use marf_export::{CrateOptions, Data, ExportError, Photos, subjects_in, write_crate};
use marf_model::Run;

use super::fixture::{KEPT, check, image, options, public_key, signing_key, world};

/// All files below a folder, by path.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = walkdir::WalkDir::new(folder).into_iter().map(Result::unwrap);
    let files = entries.filter(|entry| entry.file_type().is_file());
    files
        .map(|entry| {
            let path = entry
                .path()
                .strip_prefix(folder)
                .unwrap()
                .to_string_lossy()
                .into_owned();
            (path, std::fs::read(entry.path()).unwrap())
        })
        .collect()
}

#[test]
fn a_crate_holds_and_the_same_run_gives_the_same_bytes() {
    let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [one, two] = dirs.each_ref().map(|dir| world().write(dir.path(), &options()));
    assert_eq!(files(&one), files(&two));
    let report = check(&one);
    assert_eq!(report.faults, Vec::<String>::new());
    assert_eq!((report.actions, report.photos, report.named), (4, 3, 0));
    assert_eq!(report.signature, Signature::None);
    let names: Vec<String> = files(&one).into_keys().collect();
    assert!(
        names.contains(&"data/outputs/fit/weights.bin".to_owned()),
        "{names:?}"
    );
    let photo = format!("data/objects/{}", Digest::from_content(image("a").as_bytes()));
    assert!(names.contains(&photo), "{names:?}");
}

/// Two trainings of one set that pass it on, as trainings pass on their scene: neither was given what the other made.
#[test]
fn nodes_that_pass_on_what_they_read_are_results() {
    let dir = tempfile::tempdir().unwrap();
    let mut world = world();
    let kept = world.set(&KEPT);
    for (name, weights) in [("train-60", "a minute"), ("train-300", "five")] {
        let weights = world.put(weights.as_bytes());
        world.node(
            name,
            serde_json::json!({"budget": weights}),
            &[("photos", kept)],
            &[("photos", kept), ("weights.bin", weights)],
        );
    }
    let folder = world.write(dir.path(), &options());
    assert_eq!(check(&folder).faults, Vec::<String>::new());
    let graph: serde_json::Value =
        serde_json::from_slice(&files(&folder)["data/ro-crate-metadata.json"]).unwrap();
    let run = graph["@graph"]
        .as_array()
        .unwrap()
        .iter()
        .find(|entity| entity["@id"] == "#run")
        .unwrap();
    let results: Vec<&str> = run["result"]
        .as_array()
        .unwrap()
        .iter()
        .map(|id| id["@id"].as_str().unwrap())
        .collect();
    for node in ["fit", "train-60", "train-300"] {
        assert!(
            results.contains(&format!("outputs/{node}/weights.bin").as_str()),
            "{node}: {results:?}"
        );
    }
}

#[test]
fn a_crate_without_data_names_what_it_leaves_out() {
    let dir = tempfile::tempdir().unwrap();
    let without = CrateOptions {
        data: Data::Named,
        ..options()
    };
    let folder = world().write(dir.path(), &without);
    let report = check(&folder);
    assert_eq!(report.faults, Vec::<String>::new());
    assert_eq!(
        (report.photos, report.named),
        (3, 6),
        "weights, a picture, a child's weights, three photos"
    );
    let bytes = files(&folder).into_values();
    let found = bytes.filter(|bytes| bytes.starts_with(b"pixels") || bytes.starts_with(b"weights"));
    assert_eq!(found.count(), 0);
}

#[test]
fn chosen_photos_come_with_every_decision_on_them() {
    let dir = tempfile::tempdir().unwrap();
    let chosen = CrateOptions {
        photos: Photos::Chosen(vec!["name with spaces".to_owned(), "a".to_owned()]),
        ..options()
    };
    let folder = world().write(dir.path(), &chosen);
    let report = check(&folder);
    assert_eq!(
        (report.faults, report.named),
        (vec![], 1),
        "the photo that was not chosen"
    );
    let files = files(&folder);
    let items: Vec<&String> = files
        .keys()
        .filter(|path| path.starts_with("data/items/"))
        .collect();
    assert_eq!(items.len(), 4, "two photos, two nodes: {items:?}");
    let graph = String::from_utf8_lossy(&files["data/ro-crate-metadata.json"]).into_owned();
    assert!(graph.contains("\"size of name with spaces\""));
    assert!(!files.contains_key(&format!(
        "data/objects/{}",
        Digest::from_content(image("b").as_bytes())
    )));
}

#[test]
fn a_photo_that_is_not_there_is_refused_and_nothing_is_left() {
    let dir = tempfile::tempdir().unwrap();
    let (_store, store) = world().stored();
    let run = Run::open(&store, 1).unwrap();
    let unknown = CrateOptions {
        photos: Photos::Chosen(vec!["z".to_owned()]),
        ..options()
    };
    let folder = dir.path().join("crate");
    let error = write_crate(&run, &unknown, &folder).unwrap_err();
    assert!(matches!(error, ExportError::UnknownItem { .. }), "{error}");
    let mut without_weights = world();
    without_weights.objects.remove(&Digest::from_content(b"weights"));
    let (_lost, lost) = without_weights.stored();
    let error = write_crate(&Run::open(&lost, 1).unwrap(), &options(), &folder)
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("`weights.bin` of `fit` (object "), "{error}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    write_crate(&run, &options(), &folder).unwrap();
    let error = write_crate(&run, &options(), &folder).unwrap_err();
    assert!(matches!(error, ExportError::Exists { .. }), "{error}");
}

#[test]
fn a_signed_crate_is_signed_over_its_manifest() {
    let dir = tempfile::tempdir().unwrap();
    let key = signing_key();
    let signed = CrateOptions {
        key: Some(&key),
        ..options()
    };
    let folder = world().write(dir.path(), &signed);
    let report = verify(&folder, Some(&public_key()), &Cancel::default()).unwrap();
    assert_eq!(report.faults, Vec::<String>::new());
    assert_eq!(report.signature, Signature::Good);
    assert_eq!(check(&folder).signature, Signature::NotChecked);
}

#[test]
fn a_statement_names_results_and_everything_they_depend_on() {
    let (_dir, store) = world().stored();
    let run = Run::open(&store, 1).unwrap();
    let weights = [("fit/weights.bin".to_owned(), Digest::from_content(b"weights"))];
    let subjects = marf_export::subjects_of(&run, weights.into_iter()).unwrap();
    let node = run.node("fit").unwrap();
    let statement = marf_export::statement_on_node(&run, node, &subjects).unwrap();
    let expected = vec![("fit/weights.bin".to_owned(), Sha256::from_content(b"weights"))];
    assert_eq!(subjects_in(&statement), Some(expected));
    let json: serde_json::Value = serde_json::from_slice(&statement).unwrap();
    let definition = &json["predicate"]["buildDefinition"];
    assert_eq!(definition["externalParameters"]["action"]["params"]["seed"], 0);
    let names: Vec<&str> = definition["resolvedDependencies"]
        .as_array()
        .unwrap()
        .iter()
        .map(|dependency| dependency["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["pipeline.toml", "input photos"]);
    assert_eq!(
        json["predicate"]["runDetails"]["metadata"]["startedOn"],
        "2001-09-09T01:46:41Z"
    );
    assert_eq!(subjects_in(b"{}"), None);
}

#[test]
fn a_crate_tells_where_its_bytes_came_from() {
    let dir = tempfile::tempdir().unwrap();
    let folder = world().write(dir.path(), &options());
    let opened = OpenCrate::open(&folder, &Cancel::default()).unwrap();
    let trace = opened.trace(&Digest::from_content(b"weights")).unwrap().unwrap();
    let output = Role::Output {
        node: "fit".to_owned(),
        output: "weights.bin".to_owned(),
    };
    assert_eq!(trace.is, [output]);
    let steps: Vec<&str> = trace.steps.iter().map(|step| step.node.as_str()).collect();
    assert_eq!(steps, ["extract", "size", "fit", "fit/member-00"]);
    assert_eq!(trace.steps[2].reads["photos"].as_deref(), Some("size"));
    let ids: Vec<&str> = trace.products.iter().map(|product| product.id.as_str()).collect();
    assert_eq!(ids, KEPT, "the photo that was rejected is none of them");
    assert_eq!(
        trace.products[0].files[0].url.as_deref(),
        Some("https://archive.example/a.png")
    );

    assert_eq!(trace.run, "6e10105061dd45eb");
    assert_eq!((trace.photos_read, trace.products.len()), (3, KEPT.len()));
    assert_eq!(trace.steps[0].reads["listing"], None, "from outside");

    let photo = opened
        .trace(&Digest::from_content(image("b").as_bytes()))
        .unwrap()
        .unwrap();
    assert_eq!(photo.products.len(), 1);
    assert_eq!(photo.steps.len(), 1, "only its source");
    assert!(
        opened
            .trace(&Digest::from_content(b"a stranger's"))
            .unwrap()
            .is_none()
    );
}
