//! A second level of the store: the requests it gets, and the results it is offered.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Arc, Mutex},
};

use marf_cache::{Digest, Record, Store};
use marf_engine::{Cancel, Options, RunRecord, SharedResults, action_at};

use crate::common::{EventLog, TestPipeline, fresh_store, new_fixture, options, ran, run_on, run_with};

/// Another store on the same disk as the shared one.
#[derive(Debug)]
struct Neighbour {
    from: PathBuf,
    to: PathBuf,
    offered: Mutex<Vec<Digest>>,
}

impl Neighbour {
    fn between(from: &Store, to: &Store) -> Arc<Self> {
        Arc::new(Self {
            from: from.dir().to_owned(),
            to: to.dir().to_owned(),
            offered: Mutex::default(),
        })
    }
}

impl SharedResults for Neighbour {
    fn fetch(&self, keys: &[Digest]) {
        let (from, to) = (Store::open(&self.from).unwrap(), Store::open(&self.to).unwrap());
        let mut keys = keys.to_vec();
        while let Some(key) = keys.pop() {
            let Some(record) = from.record(&key).unwrap() else {
                continue;
            };
            let belongings = from.belongings(&record).unwrap();
            for blob in &belongings.blobs {
                to.put(&from.get(blob).unwrap()).unwrap();
            }
            keys.extend(belongings.keys);
            to.put_record(record);
        }
        to.commit().unwrap();
    }

    fn record(&self, key: &Digest) -> Option<Record> {
        Store::open(&self.from).unwrap().record(key).unwrap()
    }

    fn offer(&self, key: &Digest) {
        self.offered.lock().unwrap().push(*key);
    }
}

/// Returns the pipeline on an archive of two shards.
fn pipeline() -> TestPipeline {
    let (number, fixture) = new_fixture();
    fixture.put_shard(1);
    fixture.put_shard(2);
    TestPipeline::new(number)
}

fn run_beside(pipeline: &TestPipeline, store: &Store, shared: &Arc<Neighbour>) -> (RunRecord, EventLog) {
    let options = Options {
        shared: Some(Arc::clone(shared) as Arc<dyn SharedResults>),
        ..options(2)
    };
    run_with(&pipeline.graph(), store, &options, &Cancel::default())
}

#[test]
fn what_the_shared_store_has_is_not_made_and_comes_whole() {
    let pipeline = pipeline();
    let ((_here_dir, here), (_there_dir, there)) = (fresh_store(), fresh_store());
    let (first, _) = run_on(&pipeline.graph(), &here);
    let shared = Neighbour::between(&here, &there);
    let (second, log) = run_beside(&pipeline, &there, &shared);
    assert_eq!(ran(&log), Vec::<String>::new());
    assert_eq!(
        *shared.offered.lock().unwrap(),
        Vec::<Digest>::new(),
        "nothing new"
    );
    let keys: Vec<Digest> = first.nodes.iter().filter_map(|node| node.key).collect();
    assert!(
        second
            .nodes
            .iter()
            .all(|node| node.key.is_none_or(|key| keys.contains(&key)))
    );
    let closure = there.closure(&keys, &[]).unwrap();
    assert_eq!(closure.missing, []);
    assert_eq!(here.closure(&keys, &[]).unwrap().missing, []);
    assert_eq!(closure.keys, here.closure(&keys, &[]).unwrap().keys);
}

/// A key does not depend on children, so a record that another program wrote may name any.
#[test]
fn a_foreign_record_that_is_its_own_descendant_or_has_many_levels_ends_no_run() {
    let pipeline = pipeline();
    let ((_here_dir, here), (_there_dir, there)) = (fresh_store(), fresh_store());
    let (first, _) = run_on(&pipeline.graph(), &here);
    let (again, _) = run_on(&pipeline.graph(), &here);
    let many = first.node("many").unwrap().key.unwrap();
    let whole = here.record(&many).unwrap().unwrap();
    // A chain of twenty results, each the child of the one before it.
    let mut deepest = None;
    for level in 0..20 {
        let mut action = action_at(&here, &many).unwrap().unwrap();
        action.params = serde_json::json!({ "level": level });
        let mut record = Record {
            key: there.put(&action.encode()).unwrap(),
            ..whole.clone()
        };
        record.children = BTreeMap::from_iter(deepest.map(|key| ("next".to_owned(), key)));
        deepest = Some(record.key);
        there.put_record(record);
    }
    for mut record in here.records().unwrap() {
        for blob in here.belongings(&record).unwrap().blobs {
            there.put(&here.get(&blob).unwrap()).unwrap();
        }
        if record.key == many || whole.children.values().any(|child| *child == record.key) {
            record.children.insert("itself".to_owned(), many);
        }
        if record.key == many {
            record
                .children
                .extend(deepest.map(|key| ("deep".to_owned(), key)));
        }
        there.put_record(record);
    }
    there.commit().unwrap();
    let (foreign, log) = run_on(&pipeline.graph(), &there);
    assert_eq!(ran(&log), Vec::<String>::new());
    let names = |run: &RunRecord| run.nodes.iter().map(|node| node.name.clone()).collect::<Vec<_>>();
    let (deep, listed): (Vec<_>, Vec<_>) = names(&foreign)
        .into_iter()
        .partition(|name| name.starts_with("many/deep"));
    assert_eq!(listed, names(&again));
    assert_eq!(deep.len(), 8, "{deep:?}");
}

#[test]
fn what_it_lacks_is_made_and_offered_once() {
    let pipeline = pipeline();
    let ((_here_dir, here), (_there_dir, there)) = (fresh_store(), fresh_store());
    run_on(&pipeline.graph(), &here);
    let shared = Neighbour::between(&here, &there);
    let changed = TestPipeline { times: 2, ..pipeline };
    let (record, log) = run_beside(&changed, &there, &shared);
    let made = ran(&log);
    assert!(
        made.contains(&"sum".to_owned()) && !made.contains(&"archive".to_owned()),
        "{made:?}"
    );
    let mut offered = shared.offered.lock().unwrap().clone();
    let made = record.nodes.iter().filter(|node| made.contains(&node.name));
    let mut made: Vec<Digest> = made.filter_map(|node| node.key).collect();
    offered.sort_unstable();
    made.sort_unstable();
    assert_eq!(offered, made);
}
