//! A folder as a shared store, and own stores with a run in them.
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test file uses a part; a test that cannot go on should stop"
)]

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use marf_cache::{Digest, Output, Record, RunMetadata, Store, digest_list, manifest};
use marf_remote::{Observer, Patience, Progress, Remote, RemoteRun, Trust};

/// An observer that stops the work if `stop` is set.
#[derive(Default)]
pub struct Quiet {
    pub stop: AtomicBool,
}

impl Observer for Quiet {
    fn on_progress(&self, progress: Progress) {
        assert!(progress.done_bytes <= progress.total_bytes, "{progress:?}");
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }
}

/// A folder with a shared store and local stores.
pub struct World {
    pub dir: tempfile::TempDir,
}

impl World {
    pub fn new() -> Self {
        Self {
            dir: tempfile::tempdir().unwrap(),
        }
    }

    pub fn folder(&self) -> PathBuf {
        self.dir.path().join("shared")
    }

    pub fn url(&self) -> String {
        format!("file://{}", self.folder().display())
    }

    pub fn remote(&self) -> Remote {
        self.remote_of(Trust::default())
    }

    pub fn remote_of(&self, trust: Trust) -> Remote {
        Remote::open(&self.url(), Patience::Patient, trust).unwrap()
    }

    pub fn store(&self, name: &str) -> Store {
        Store::open(self.dir.path().join(name)).unwrap()
    }

    /// Returns the only file of the shared store below a folder with this ending.
    pub fn files(&self, folder: &str, ending: &str) -> Vec<PathBuf> {
        let mut found = Vec::new();
        collect(&self.folder().join(folder), &mut found);
        found.retain(|path| path.to_string_lossy().ends_with(ending));
        found.sort();
        found
    }
}

fn collect(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, found)
        } else {
            found.push(path)
        }
    }
}

/// Stores a result: an output, a small and a large need, parts and children.
pub fn result(
    store: &Store,
    name: &str,
    output: &[u8],
    parts: &[Digest],
    children: &[(&str, Digest)],
) -> Digest {
    let key = store.put(format!("action {name}").as_bytes()).unwrap();
    let output = Output {
        digest: store.put(output).unwrap(),
        bytes: output.len() as u64,
    };
    let needs = [
        store.put(format!("need of {name}").as_bytes()).unwrap(),
        store.put(&name.repeat(70_000).into_bytes()).unwrap(),
    ];
    let leaves = parts.iter().zip(0..).map(|(key, shard)| manifest::LeafRef {
        shard,
        leaf: *key,
        rows: 0,
    });
    let parts = manifest::Root {
        leaves: leaves.collect(),
    };
    store.put_record(Record {
        key,
        stage: "stage".to_owned(),
        outputs: BTreeMap::from([("out".to_owned(), output)]),
        needs: Some(store.put(&digest_list(&needs)).unwrap()),
        parts: (!parts.leaves.is_empty()).then(|| parts.write(|bytes| store.put(bytes)).unwrap()),
        children: children
            .iter()
            .map(|(name, key)| ((*name).to_owned(), *key))
            .collect(),
        origins: None,
        metadata: RunMetadata::default(),
    });
    key
}

/// A run of a node with two parts and a node with a child.
pub fn run_in(store: &Store) -> RemoteRun {
    let parts = [
        result(store, "part 1", b"1", &[], &[]),
        result(store, "part 2", b"2", &[], &[]),
    ];
    let child = result(store, "child", b"c", &[], &[]);
    let keys = vec![
        result(store, "map", b"m", &parts, &[]),
        result(store, "expand", b"e", &[], &[("child", child)]),
    ];
    let document = store.put(b"name = \"run\"").unwrap();
    store.commit().unwrap();
    RemoteRun {
        pipeline: "mars".to_owned(),
        started_unix_s: 1_700_000_000,
        keys,
        blobs: vec![document],
        root: "{\"pipeline\":\"mars\"}".to_owned(),
    }
}
