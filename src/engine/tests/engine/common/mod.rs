//! Small stages, a pipeline of them, and an event log, for tests of the engine.

mod crowd;
mod damage;
mod events;
mod fixture;
mod pipeline;
mod rounds;
mod stages;

use marf_cache::{
    Digest, Store,
    manifest::{ManifestError, Root},
};
use marf_engine::{Cancel, Graph, Options, RunRecord};

pub use damage::{damage, damage_each_object, damage_object, packs_with};
pub use events::{EventLog, node_events, ran, reason_of, warnings};
pub use fixture::{Fixture, new_fixture};
pub use pipeline::{TABLE, TestPipeline, node};

/// Returns options with this many threads.
pub fn options(threads: usize) -> Options {
    Options {
        threads: std::num::NonZero::new(threads),
        pipeline: "test".to_owned(),
        ..Options::default()
    }
}

/// Runs a graph on two threads.
pub fn run_on(graph: &Graph, store: &Store) -> (RunRecord, EventLog) {
    run_with(graph, store, &options(2), &Cancel::default())
}

/// Runs a graph and returns its record and events.
pub fn run_with(graph: &Graph, store: &Store, options: &Options, cancel: &Cancel) -> (RunRecord, EventLog) {
    let log = EventLog::default();
    let record = marf_engine::run(graph, store, options, &log, cancel).unwrap();
    (record, log)
}

/// Returns an empty store in a temporary folder.
pub fn fresh_store() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path().join(".marf")).unwrap();
    (dir, store)
}

/// Returns an output of a node as text.
pub fn text(store: &Store, record: &RunRecord, node: &str, output: &str) -> String {
    let output = record.node(node).unwrap().outputs[output];
    String::from_utf8(store.get(&output.digest).unwrap().to_vec()).unwrap()
}

/// Reads a set.
pub fn set_of(store: &Store, root: &Digest) -> Root {
    Root::read(root, |digest| Ok::<_, ManifestError>(store.get(digest).unwrap())).unwrap()
}

/// Fails on a warning.
pub fn no_warning(message: String) {
    panic!("{message}");
}
