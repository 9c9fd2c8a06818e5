use std::path::Path;

use marf_cache::Store;
use marf_model::Run;
use marf_provenance::verify::{Verified, check, verify};

use super::common::{Pipeline, fresh_store, picture};

fn verified(store: &Store, run: u64, node: &str) -> Verified {
    let check = check(store).unwrap();
    let lineage = Run::open(store, run).unwrap();
    verify(&lineage, &lineage.upstream(node), &check).unwrap()
}

/// Flips one bit of the only place in the files of a folder that holds these bytes.
fn flip(dir: &Path, bytes: &[u8]) {
    let mut flipped = 0;
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let mut file = std::fs::read(&path).unwrap();
        if let Some(at) = file.windows(bytes.len()).position(|window| window == bytes) {
            file[at] ^= 1;
            std::fs::remove_file(&path).unwrap();
            std::fs::write(&path, file).unwrap();
            flipped += 1;
        }
    }
    assert_eq!(flipped, 1);
}

#[test]
fn a_whole_lineage_is_read_to_the_last_byte() {
    let (_dir, store) = fresh_store();
    let run = Pipeline::default().run(&store);
    let whole = verified(&store, run.number, "many");
    assert_eq!((whole.faults.len(), whole.missing.len()), (0, 0), "{whole:?}");
    assert_eq!(whole.products, 6);
    let some = verified(&store, run.number, "sum");
    assert!(some.objects < whole.objects && some.bytes < whole.bytes);
}

#[test]
fn damage_is_named_and_tells_only_those_who_depend_on_it() {
    let (dir, store) = fresh_store();
    let run = Pipeline::default().run(&store);
    drop(store);
    flip(&dir.path().join(".marf/packs"), &picture("a1"));
    let store = Store::open(dir.path().join(".marf")).unwrap();
    let found = verified(&store, run.number, "sum");
    assert_eq!(found.faults.len(), 1, "{found:?}");
    assert_eq!(
        found.faults[0].object,
        Some(marf_cache::Digest::from_content(&picture("a1")))
    );
    assert_eq!(found.missing, [], "what is damaged is not missing");
    // Nothing was set aside: a second look finds the same.
    assert_eq!(verified(&store, run.number, "sum"), found);
}

/// A rewritten run root with a fitting digest disagrees with its objects.
#[test]
fn a_run_root_that_says_other_than_its_objects_is_found() {
    let (_dir, store) = fresh_store();
    let run = Pipeline::default().run(&store);
    let text = String::from_utf8(store.run(run.number).unwrap()).unwrap();
    let of = |node: &str, output: &str| run.node(node).unwrap().outputs[output].digest.to_string();
    for (was, is, what) in [
        (
            of("many", "mean"),
            of("sum", "sum"),
            "other outputs than its record",
        ),
        (
            of("pick", "photos"),
            of("archive", "photos"),
            "other inputs than its action",
        ),
    ] {
        let number = store.put_run(text.replace(&was, &is).as_bytes()).unwrap();
        let found = verified(&store, number, "many");
        assert!(
            found.faults.iter().any(|fault| fault.what.ends_with(what)),
            "{what}: {found:?}"
        );
    }
}

#[test]
fn what_was_collected_is_named_and_the_rest_verified() {
    let (dir, store) = fresh_store();
    let run = Pipeline::default().run(&store);
    // Objects that an open store has used are not collected.
    drop(store);
    let store = Store::open(dir.path().join(".marf")).unwrap();
    let keep = run.node("pick").unwrap().key.unwrap();
    let plan = marf_cache::GcPlan {
        always: marf_cache::Roots {
            keys: vec![keep],
            blobs: Vec::new(),
        },
        ..marf_cache::GcPlan::default()
    };
    store.gc(&plan).unwrap();
    let found = verified(&store, run.number, "sum");
    assert_eq!(found.faults, []);
    assert!(
        found
            .missing
            .iter()
            .any(|lost| lost.role == "record" && lost.of == "sum"),
        "{found:?}"
    );
    assert!(found.objects > 0 && verified(&store, run.number, "pick").missing.len() < found.missing.len());
}
