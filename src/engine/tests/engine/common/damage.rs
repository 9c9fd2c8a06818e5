//! Damage to the objects of a store.

use std::path::{Path, PathBuf};

use marf_cache::{Digest, Store};
use marf_engine::{Graph, Outcome};

use super::{fresh_store, node_events, run_on};

/// Flips a bit of the last byte of a text in a file.
pub fn damage(path: &Path, wanted: &[u8]) {
    let mut bytes = std::fs::read(path).unwrap();
    let at = bytes
        .windows(wanted.len())
        .position(|window| window == wanted)
        .unwrap();
    bytes[at + wanted.len() - 1] ^= 4;
    std::fs::remove_file(path).unwrap();
    std::fs::write(path, bytes).unwrap();
}

/// Returns the packs that hold a text.
pub fn packs_with(store: &Store, wanted: &[u8]) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(store.dir().join("packs")).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|ext| ext == "pack"));
    paths.retain(|path| {
        let bytes = std::fs::read(path).unwrap();
        bytes.windows(wanted.len()).any(|window| window == wanted)
    });
    paths
}

/// Damages the stored bytes of an object, wherever they are.
pub fn damage_object(store: &Store, digest: &Digest) {
    let bytes = store.get(digest).unwrap();
    let len = (bytes.len() as u32).to_le_bytes();
    let entry = [digest.as_bytes(), len.as_slice(), &bytes].concat();
    for pack in packs_with(store, &entry) {
        damage(&pack, &entry);
    }
}

/// Returns the digests of everything that the records of a store name.
fn all_objects(store: &Store) -> Vec<Digest> {
    let mut objects = std::collections::BTreeSet::new();
    for record in store.records().unwrap() {
        objects.insert(record.key);
        objects.extend(record.outputs.values().map(|output| output.digest));
        if let Some(needs) = record.needs {
            objects.insert(needs);
            objects.extend(marf_cache::read_digest_list(&store.get(&needs).unwrap()).unwrap());
        }
        objects.extend(record.parts);
    }
    objects.into_iter().collect()
}

/// Runs a graph once for every object that its run stores. Damages the object, runs another graph that needs it, and compares the outputs
/// of all nodes with those of an empty store. Returns the number of objects.
pub fn damage_each_object(before: &Graph, after: &Graph) -> usize {
    let (_dir, empty) = fresh_store();
    let (expected, _) = run_on(after, &empty);
    let (_dir, store) = fresh_store();
    run_on(before, &store);
    let objects = all_objects(&store);
    for digest in &objects {
        let (_dir, store) = fresh_store();
        run_on(before, &store);
        damage_object(&store, digest);
        let (record, log) = run_on(after, &store);
        assert_eq!(record.outcome, Outcome::Done, "{digest}: {:?}", node_events(&log));
        for node in &expected.nodes {
            let outputs = &record.node(&node.name).unwrap().outputs;
            assert_eq!(outputs, &node.outputs, "{digest} of {}", node.name);
        }
    }
    objects.len()
}
