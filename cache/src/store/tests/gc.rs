//! Closures and collections.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use super::*;
use crate::manifest::{Leaf, LeafRef, Root, Row};

fn plan(keys: &[Digest]) -> GcPlan {
    GcPlan {
        always: Roots {
            keys: keys.to_vec(),
            blobs: Vec::new(),
        },
        ..GcPlan::default()
    }
}

/// A set of two shards with one photo each.
fn set(store: &Store, seed: u8) -> (Digest, Vec<Digest>) {
    let mut all = Vec::new();
    let mut leaves = Vec::new();
    for shard in [1, 700] {
        let image = store.put(&[seed, shard as u8].repeat(50)).unwrap();
        let leaf = Leaf::new(vec![Row {
            id: format!("photo {shard}"),
            blobs: BTreeMap::from([("image".to_owned(), image)]),
            facts: serde_json::Value::Null,
        }]);
        let leaf = store.put(&leaf.unwrap().encode()).unwrap();
        all.extend([image, leaf]);
        leaves.push(LeafRef { shard, leaf, rows: 1 });
    }
    let put = |bytes: &[u8]| store.put(bytes).inspect(|digest| all.push(*digest));
    let root = Root { leaves }.write(put).unwrap();
    all.sort_unstable();
    (root, all)
}

/// A record whose output is a set, with an input set, a list of needs, parts and a child.
fn rich(store: &Store) -> (Record, Vec<Digest>, Vec<Digest>) {
    let (input, mut blobs) = set(store, 1);
    let (output, more) = set(store, 2);
    blobs.extend(more);
    let (part, child) = (
        record("part", store, b"of part"),
        record("child", store, b"of child"),
    );
    let need = store.put(b"named by the stage alone").unwrap();
    let mut action = action("extract", "rich", &[input]);
    let listing = Root {
        leaves: vec![LeafRef {
            shard: 1,
            leaf: Digest::from_content(b"files of a sol"),
            rows: 1,
        }],
    };
    let listing = listing.write(|bytes| store.put(bytes).inspect(|digest| blobs.push(*digest)));
    action.inputs.insert(crate::LISTING.to_owned(), listing.unwrap());
    let outside = [
        ("before", Digest::from_content(&[])),
        (crate::FINGERPRINT, Digest::from_content(b"of files")),
    ];
    action
        .inputs
        .extend(outside.map(|(name, digest)| (name.to_owned(), digest)));
    let mut record = record_of(&action, output, 1);
    record.needs = Some(store.put(&digest_list(&[need])).unwrap());
    let parts = Root {
        leaves: vec![LeafRef {
            shard: 1,
            leaf: part.key,
            rows: 1,
        }],
    };
    let put = |bytes: &[u8]| store.put(bytes).inspect(|digest| blobs.push(*digest));
    record.parts = Some(parts.write(put).unwrap());
    record.children.insert("child".into(), child.key);
    blobs.extend([need, record.needs.unwrap(), store.put(&action.encode()).unwrap()]);
    blobs.extend([part.key, child.key]);
    blobs.extend([
        Digest::from_content(b"of part"),
        Digest::from_content(b"of child"),
    ]);
    blobs.sort_unstable();
    let mut keys = vec![record.key, part.key, child.key];
    keys.sort_unstable();
    for record in [&record, &part, &child] {
        store.put_record(record.clone());
    }
    store.commit().unwrap();
    (record, keys, blobs)
}

/// Makes a checkpoint of a key.
fn checkpoint(store: &Store, key: &Digest) -> PathBuf {
    let folder = store.checkpoints().join(key.to_string());
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("training"), b"").unwrap();
    folder
}

#[test]
fn a_closure_holds_action_inputs_outputs_needs_parts_and_children() {
    let (_dir, store) = fresh();
    let (record, keys, blobs) = rich(&store);
    store.put(b"of nobody").unwrap();
    let closure = store.closure(&[record.key], &[]).unwrap();
    assert_eq!(closure.keys, keys);
    assert_eq!(closure.blobs, blobs);
    assert_eq!(closure.missing, []);
}

/// Takes one object after the other out of a store that is whole.
#[test]
fn a_collection_warns_of_the_one_object_that_is_missing_and_of_no_other() {
    let (_dir, store) = fresh();
    let (record, keys, blobs) = rich(&store);
    let objects = keys.iter().map(|key| (Kind::Record, *key));
    let objects = objects.chain(blobs.iter().map(|blob| (Kind::Blob, *blob)));
    for object in objects {
        let (_dir, store) = fresh();
        rich(&store);
        store.objects.index.remove(&[object]).unwrap();
        let plan = GcPlan {
            dry_run: true,
            ..plan(&[record.key])
        };
        let missing = store.gc(&plan).unwrap().missing;
        let digests: Vec<Digest> = missing.iter().map(|one| one.digest).collect();
        assert_eq!(digests, [object.1], "{object:?}: {missing:?}");
    }
    let plan = GcPlan {
        dry_run: true,
        ..plan(&[record.key])
    };
    assert_eq!(store.gc(&plan).unwrap().missing, []);
}

#[test]
fn a_closure_lists_what_is_missing_with_what_names_it() {
    let (_dir, store) = fresh();
    let (record, ..) = rich(&store);
    let image = Digest::from_content(&[2, 1].repeat(50));
    let gone = [
        (image, "product"),
        (
            Digest::from_content(b"named by the stage alone"),
            "stored beside the outputs",
        ),
        (Digest::from_content(b"of child"), "output"),
    ];
    let rows: Vec<_> = gone.iter().map(|(digest, _)| (Kind::Blob, *digest)).collect();
    store.objects.index.remove(&rows).unwrap();
    let closure = store
        .closure(&[record.key, Digest::from_content(b"no record")], &[])
        .unwrap();
    for (digest, role) in gone
        .into_iter()
        .chain([(Digest::from_content(b"no record"), "record")])
    {
        let found = closure.missing.iter().find(|one| one.digest == digest);
        assert_eq!(found.map(|one| one.role), Some(role));
    }
}

#[test]
fn a_collection_keeps_the_closure_of_its_roots_and_removes_the_rest() {
    let (dir, store) = fresh();
    let (kept, keys, blobs) = rich(&store);
    let dead = record("dead", &store, &large(3));
    store.put_record(dead.clone());
    let memos = [(b"kept memo", kept.key), (b"dead memo", dead.key)];
    for (name, maker) in memos {
        let blob = store.put(name).unwrap();
        store.put_memo(Digest::from_content(name), blob, maker);
    }
    let [under_way, in_use, given_up] = [&b"under way"[..], b"in use", b"given up"].map(Digest::from_content);
    let checkpoints = [under_way, in_use, given_up, kept.key].map(|key| checkpoint(&store, &key));
    store.commit().unwrap();
    drop(store);
    let store = reopen(&dir);
    assert_eq!(store.hit(&in_use).unwrap(), None);
    let mut plan = plan(&[kept.key, under_way]);
    plan.dry_run = true;
    let promised = store.gc(&plan).unwrap();
    assert!(store.objects.contains(&dead.outputs["photos"].digest));
    plan.dry_run = false;
    let report = store.gc(&plan).unwrap();
    assert_eq!((report.loose_blobs, report.loose_bytes), (1, 200_000));
    assert_eq!((report.packed_blobs, report.records, report.memos), (2, 1, 1));
    assert_eq!(report.scratch, 2);
    assert_eq!(
        GcReport {
            packs: report.packs,
            pack_bytes: report.pack_bytes,
            ..promised
        },
        report
    );
    assert_eq!(checkpoints.map(|path| path.exists()), [true, true, false, false]);
    for store in [&store, &reopen(&dir)] {
        let closure = store.closure(&[kept.key], &[]).unwrap();
        assert_eq!((&closure.keys, &closure.blobs), (&keys, &blobs));
        assert_eq!(closure.missing, []);
        assert!(store.memo(&Digest::from_content(b"kept memo")).unwrap().is_some());
        assert_eq!(store.memo(&Digest::from_content(b"dead memo")).unwrap(), None);
        assert_eq!(store.record(&dead.key).unwrap(), None);
    }
    let report = store.gc(&GcPlan::default()).unwrap();
    // This store has looked at what it just checked, so it holds a lease on it.
    assert_eq!(report.memos, 0);
    drop(store);
    let store = reopen(&dir);
    store.gc(&GcPlan::default()).unwrap();
    let stat = store.stat().unwrap();
    assert_eq!((stat.packs, stat.loose_blobs, stat.records), (0, 0, 0));
}

#[test]
fn runs_are_kept_from_the_newest_on_as_long_as_they_fit() {
    let (dir, store) = fresh();
    let mut runs = Vec::new();
    for name in ["a", "b", "c"] {
        let record = record(name, &store, name.repeat(10_000).as_bytes());
        store.put_record(record.clone());
        runs.push(Roots {
            keys: vec![record.key],
            blobs: Vec::new(),
        });
    }
    store.commit().unwrap();
    drop(store);
    let store = reopen(&dir);
    let plan = GcPlan {
        runs: runs.clone(),
        max_bytes: Some(25_000),
        ..GcPlan::default()
    };
    let report = store.gc(&plan).unwrap();
    assert_eq!((report.runs_kept, report.records), (2, 1));
    assert!(report.kept_bytes <= 25_000, "{}", report.kept_bytes);
    let found = runs
        .iter()
        .map(|run| store.record(&run.keys[0]).unwrap().is_some());
    assert_eq!(found.collect::<Vec<_>>(), [true, true, false]);
}

#[test]
fn what_is_younger_than_the_grace_stays() {
    let (dir, store) = fresh();
    store.put_record(record("k", &store, &large(3)));
    let folder = checkpoint(&store, &Digest::from_content(b"given up"));
    store.commit().unwrap();
    drop(store);
    let store = reopen(&dir);
    let plan = GcPlan {
        grace: Duration::from_secs(3600),
        ..GcPlan::default()
    };
    assert_eq!(store.gc(&plan).unwrap().records, 0);
    assert_eq!((store.records().unwrap().len(), folder.exists()), (1, true));
    // The lease of the process that ended is as old as its objects.
    assert_eq!(files_below(&store.dir().join("leases")).len(), 1);
    assert_eq!(store.gc(&GcPlan::default()).unwrap().records, 1);
    assert!(!folder.exists());
    assert_eq!(files_below(&store.dir().join("leases")).len(), 0);
}

/// A clock that was set back makes files younger, never older.
#[test]
fn what_comes_from_the_future_stays_for_the_grace() {
    let (dir, store) = fresh();
    store.put_record(record("k", &store, &large(3)));
    store.commit().unwrap();
    drop(store);
    let future = std::time::SystemTime::now() + Duration::from_secs(9999);
    for path in files_below(dir.path()) {
        fs::File::open(path).unwrap().set_modified(future).unwrap();
    }
    let plan = GcPlan {
        grace: Duration::from_secs(1),
        ..GcPlan::default()
    };
    let report = reopen(&dir).gc(&plan).unwrap();
    assert_eq!((report.records, report.loose_blobs), (0, 0));
}

#[test]
fn what_a_process_found_stays_until_it_ends() {
    let (dir, store) = fresh();
    let found = record("hit", &store, b"output of a hit");
    store.put_record(found.clone());
    let again_put = store.put(&large(5)).unwrap();
    let memo_blob = store.put(b"features").unwrap();
    store.put_memo(
        Digest::from_content(b"m"),
        memo_blob,
        Digest::from_content(b"nobody"),
    );
    store.commit().unwrap();
    drop(store);
    let user = reopen(&dir);
    assert!(user.hit(&found.key).unwrap().is_some());
    user.put(&large(5)).unwrap();
    assert!(user.memo(&Digest::from_content(b"m")).unwrap().is_some());
    let collector = reopen(&dir);
    collector.gc(&GcPlan::default()).unwrap();
    assert!(user.hit(&found.key).unwrap().is_some());
    assert_eq!(
        &*user.get(&found.outputs["photos"].digest).unwrap(),
        b"output of a hit"
    );
    assert_eq!(&*user.get(&again_put).unwrap(), large(5));
    assert_eq!(&*user.get(&memo_blob).unwrap(), b"features");
    drop(user);
    collector.gc(&GcPlan::default()).unwrap();
    assert_eq!(collector.stat().unwrap().packs, 0);
}

/// A process uses one object of a kept run after the other: an action, a leaf, a list, a record.
#[test]
fn a_kept_run_is_whole_whatever_of_it_a_process_uses() {
    let (_dir, store) = fresh();
    let (record, keys, blobs) = rich(&store);
    let plan = GcPlan {
        runs: vec![Roots {
            keys: vec![record.key],
            blobs: Vec::new(),
        }],
        ..GcPlan::default()
    };
    let whole = |user: &dyn Fn(&Store), what: Digest| {
        let (dir, store) = fresh();
        rich(&store);
        drop(store);
        let store = reopen(&dir);
        user(&store);
        let collector = reopen(&dir);
        assert_eq!(collector.gc(&plan).unwrap().missing, [], "{what}");
        drop(store);
        let closure = collector.closure(&[record.key], &[]).unwrap();
        assert_eq!(
            (&closure.keys, &closure.blobs, closure.missing),
            (&keys, &blobs, Vec::new()),
            "{what}"
        );
    };
    for blob in &blobs {
        let bytes = store.get(blob).unwrap();
        whole(&|user| assert_eq!(user.put(&bytes).unwrap(), *blob), *blob);
    }
    for key in &keys {
        whole(&|user| assert!(user.hit(key).unwrap().is_some()), *key);
    }
}

/// Also without a run that keeps it.
#[test]
fn a_result_that_a_process_uses_keeps_its_inputs() {
    let (dir, store) = fresh();
    let input = store.put(b"of a result in use").unwrap();
    let action = action("blur", "with an input", &[input]);
    store.put(&action.encode()).unwrap();
    let record = record_of(&action, store.put(b"output").unwrap(), 6);
    store.put_record(record.clone());
    store.commit().unwrap();
    drop(store);
    let user = reopen(&dir);
    assert!(user.hit(&record.key).unwrap().is_some());
    let collector = reopen(&dir);
    collector.gc(&GcPlan::default()).unwrap();
    assert_eq!(&*user.get(&input).unwrap(), b"of a result in use");
    drop(user);
    assert_eq!(collector.gc(&GcPlan::default()).unwrap().records, 1);
}

/// Writers that share blobs, processes that come and go, and a collector without any grace.
#[test]
fn collections_beside_writers_lose_no_committed_result() {
    let rounds = super::rounds(25);
    let (dir, _store) = fresh();
    let is_done = AtomicBool::new(false);
    let shared = |round: usize, at: usize| match at {
        0 => [round as u8 % 7, 1].repeat(40_000),
        _ => [round as u8 % 5, at as u8].repeat(200),
    };
    std::thread::scope(|scope| {
        let writers: Vec<_> = (0..4_usize)
            .map(|writer| {
                let store = reopen(&dir);
                scope.spawn(move || {
                    let mut records = Vec::new();
                    for round in 0..rounds {
                        let action = action("blur", &format!("{writer} {round}"), &[]);
                        store.put(&action.encode()).unwrap();
                        let outputs = (0..3).map(|at| (at, store.put(&shared(round, at)).unwrap()));
                        let outputs: Vec<_> = outputs.collect();
                        let mut record = record_of(&action, outputs[0].1, 80_000);
                        for (at, digest) in outputs {
                            record.outputs.insert(at.to_string(), Output { digest, bytes: 1 });
                        }
                        store.put_record(record.clone());
                        store.commit().unwrap();
                        records.push(record);
                        for record in &records {
                            let found = store.hit(&record.key).unwrap();
                            assert_eq!(found.as_ref(), Some(record), "writer {writer}, round {round}");
                            for output in record.outputs.values() {
                                store.get(&output.digest).unwrap();
                            }
                        }
                    }
                    (store, records)
                })
            })
            .collect();
        let (dir, is_done) = (&dir, &is_done);
        scope.spawn(move || {
            let mut round = 0;
            while !is_done.load(Ordering::Relaxed) {
                let store = reopen(dir);
                store.put_record(record(&format!("passing {round}"), &store, &shared(round, 1)));
                store.commit().unwrap();
                round += 1;
            }
        });
        let collector = scope.spawn(move || {
            let store = reopen(dir);
            let mut removed = 0;
            while !is_done.load(Ordering::Relaxed) {
                removed += store.gc(&GcPlan::default()).unwrap().records;
            }
            removed
        });
        let results: Vec<_> = writers.into_iter().map(|writer| writer.join()).collect();
        is_done.store(true, Ordering::Relaxed);
        let removed = collector.join().unwrap();
        assert!(removed > 0, "nothing was collected");
        let last = reopen(dir);
        for (_store, records) in results.iter().flatten() {
            for record in records {
                assert_eq!(last.hit(&record.key).unwrap().as_ref(), Some(record));
            }
        }
        assert!(results.iter().all(Result::is_ok));
    });
}
