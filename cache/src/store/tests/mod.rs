mod damage;
mod faults;
mod gc;
mod index;
mod layer;
mod pack;
mod processes;
mod session;
mod storing;
mod upstream;

use std::{collections::BTreeMap, fs};

use super::*;
use crate::Action;

fn fresh() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path().join(".marf")).unwrap();
    (dir, store)
}

fn reopen(dir: &tempfile::TempDir) -> Store {
    Store::open(dir.path().join(".marf")).unwrap()
}

/// As [`again`], without waits for the disk, which are most of the time of a test of many rounds.
fn again_unsynced(dir: &tempfile::TempDir) -> Store {
    let layer = layer::Faulty::new(usize::MAX, layer::Mishap::Crash, &dir.path().join("kept"));
    Store::open_on(
        dir.path().join(".marf"),
        Files::with_operations(layer),
        Notices::default(),
    )
    .unwrap()
}

/// An action of a stage with these inputs.
fn action(stage: &str, name: &str, inputs: &[Digest]) -> Action {
    let inputs = inputs.iter().enumerate();
    Action {
        action: crate::ACTION_FORMAT,
        stage: stage.into(),
        version: 1,
        part: None,
        shard: None,
        params: serde_json::json!({ "name": name }),
        inputs: inputs.map(|(at, digest)| (at.to_string(), *digest)).collect(),
        backend: None,
        children: BTreeMap::new(),
    }
}

/// The record of an action with one output.
fn record_of(action: &Action, output: Digest, bytes: u64) -> Record {
    Record {
        key: action.key(),
        stage: action.stage.clone(),
        outputs: BTreeMap::from([(
            "photos".to_owned(),
            Output {
                digest: output,
                bytes,
            },
        )]),
        needs: None,
        parts: None,
        children: BTreeMap::new(),
        origins: None,
        metadata: RunMetadata::default(),
    }
}

/// Stores an output and an action, and returns the record.
fn record(name: &str, store: &Store, output: &[u8]) -> Record {
    let action = action("blur", name, &[]);
    store.put(&action.encode()).unwrap();
    record_of(&action, store.put(output).unwrap(), output.len() as u64)
}

fn large(seed: u8) -> Vec<u8> {
    (0..200_000_u32).map(|at| (at as u8).wrapping_mul(seed)).collect()
}

/// All files below a folder, by path.
fn files_below(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files_below(&path))
        } else {
            found.push(path)
        }
    }
    found.sort();
    found
}

/// Replaces a file, which may be read-only.
fn replace(path: &Path, bytes: &[u8]) {
    fs::remove_file(path).unwrap();
    fs::write(path, bytes).unwrap();
}

fn packs(store: &Store) -> Vec<PathBuf> {
    files_below(&store.dir().join("packs"))
}

/// Returns the number of rounds of a test of faults: `MARF_FAULT_ROUNDS`, or else `usual`.
fn rounds(usual: usize) -> usize {
    let wanted = std::env::var("MARF_FAULT_ROUNDS").ok();
    wanted.and_then(|text| text.parse().ok()).unwrap_or(usual)
}
