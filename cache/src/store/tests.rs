use std::{collections::BTreeMap, fs, time::Duration};

use proptest::prelude::*;

use super::*;

fn fresh() -> (tempfile::TempDir, Store) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path().join(".marf")).unwrap();
    (dir, store)
}

fn again(dir: &tempfile::TempDir) -> Store {
    Store::open(dir.path().join(".marf")).unwrap()
}

fn record(key: &str, store: &Store, output: &[u8]) -> Record {
    let output = Output {
        digest: store.put(output).unwrap(),
        bytes: output.len() as u64,
    };
    Record {
        key: Digest::of(key.as_bytes()),
        stage: "blur".into(),
        version: 1,
        manifest: "stage = \"blur\"\n".into(),
        outputs: BTreeMap::from([("photos".to_owned(), output)]),
        children: BTreeMap::new(),
        metadata: RunMetadata::default(),
    }
}

fn large(seed: u8) -> Vec<u8> {
    (0..200_000_u32).map(|at| (at as u8).wrapping_mul(seed)).collect()
}

/// All files below a folder, by path.
fn files_below(dir: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for name in files::names(dir).unwrap() {
        let path = dir.join(name);
        match path.is_dir() {
            true => found.extend(files_below(&path)),
            false => found.push(path),
        }
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_is_put_comes_back_before_and_after_a_commit_and_reopening(
        lengths in prop::collection::vec(prop_oneof![0_usize..300, 65_000_usize..66_000], 1..12),
        seed: u8,
    ) {
        let (dir, store) = fresh();
        let blobs: Vec<Vec<u8>> = lengths.iter().enumerate()
            .map(|(index, len)| (0..*len).map(|at| (at * 31 + index) as u8 ^ seed).collect())
            .collect();
        let digests: Vec<Digest> = blobs.iter().map(|blob| store.put(blob).unwrap()).collect();
        for (digest, blob) in digests.iter().zip(&blobs) {
            prop_assert_eq!(&*store.get(digest).unwrap(), blob.as_slice());
        }
        store.commit().unwrap();
        let other = again(&dir);
        for (digest, blob) in digests.iter().zip(&blobs) {
            prop_assert_eq!(&*store.get(digest).unwrap(), blob.as_slice());
            prop_assert_eq!(&*other.get(digest).unwrap(), blob.as_slice());
            prop_assert_eq!(other.size_of(digest), Some(blob.len() as u64));
        }
    }

    #[test]
    fn a_flipped_bit_is_quarantined_and_never_served(position in 0.0_f64..1.0, bit in 0_u8..8, seed in 1_u8..) {
        for blob in [large(seed), vec![seed; 3000]] {
            let (dir, store) = fresh();
            let digest = store.put(&blob).unwrap();
            store.commit().unwrap();
            let damaged = files_below(store.dir()).into_iter()
                .find(|path| path.extension().is_some_and(|ext| ext == "pack") || path.iter().any(|part| part == "cas"))
                .unwrap();
            let mut bytes = fs::read(&damaged).unwrap();
            let payload = bytes.len() - blob.len();
            let at = payload + (position * blob.len() as f64) as usize;
            bytes[at] ^= 1 << bit;
            fs::remove_file(&damaged).unwrap();
            fs::write(&damaged, &bytes).unwrap();
            let error = store.get(&digest).unwrap_err();
            prop_assert!(matches!(error, StoreError::Damaged { .. }), "{}", error);
            prop_assert_eq!(error.lost(), Some(digest));
            prop_assert!(!store.contains(&digest), "still claimed");
            prop_assert!(!again(&dir).contains(&digest), "claimed after reopening");
            prop_assert_eq!(store.stat().unwrap().quarantined, 1);
            prop_assert_eq!(store.put(&blob).unwrap(), digest);
            store.commit().unwrap();
            prop_assert_eq!(&*again(&dir).get(&digest).unwrap(), blob.as_slice());
        }
    }
}

#[test]
fn a_record_is_seen_at_once_here_and_after_a_commit_elsewhere() {
    let (dir, store) = fresh();
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    assert_eq!(store.hit(&record.key).unwrap().as_ref(), Some(&record));
    assert_eq!(again(&dir).hit(&record.key).unwrap(), None);
    store.commit().unwrap();
    assert_eq!(again(&dir).hit(&record.key).unwrap().as_ref(), Some(&record));
    assert_eq!(again(&dir).records().unwrap(), vec![record]);
}

#[test]
fn a_second_different_result_is_refused_and_reported_once() {
    let (_dir, store) = fresh();
    let (first, second) = (record("k", &store, b"one"), record("k", &store, b"two"));
    store.put_record(first.clone());
    store.commit().unwrap();
    store.put_record(first.clone());
    store.commit().unwrap();
    assert_eq!(store.take_conflicts(), vec![]);
    store.put_record(second.clone());
    store.commit().unwrap();
    assert_eq!(store.hit(&first.key).unwrap(), Some(first.clone()));
    let conflicts = store.take_conflicts();
    assert_eq!(conflicts.len(), 1);
    assert_eq!(
        (&conflicts[0].kept, &conflicts[0].refused),
        (&first.outputs, &second.outputs)
    );
    assert_eq!(store.take_conflicts(), vec![]);
}

#[test]
fn a_record_whose_output_is_gone_is_a_miss_and_may_be_replaced() {
    let (dir, store) = fresh();
    let first = record("k", &store, &large(3));
    store.put_record(first.clone());
    store.commit().unwrap();
    fs::remove_file(store.objects.loose_path(&first.outputs["photos"].digest)).unwrap();
    assert_eq!(store.hit(&first.key).unwrap(), None);
    let second = record("k", &store, &large(5));
    store.put_record(second.clone());
    store.commit().unwrap();
    assert_eq!(again(&dir).hit(&first.key).unwrap(), Some(second));
    assert_eq!(store.take_conflicts(), vec![]);
}

#[test]
fn a_memo_may_be_replaced() {
    let (dir, store) = fresh();
    let key = Digest::of(b"memo");
    for text in [b"one".as_slice(), b"two"] {
        let blob = store.put(text).unwrap();
        store.put_memo(key, blob);
        assert_eq!(store.memo(&key).unwrap(), Some(blob));
        store.commit().unwrap();
        assert_eq!(again(&dir).memo(&key).unwrap(), Some(blob));
    }
}

#[test]
fn a_crash_between_blobs_and_records_leaves_orphans_only() {
    let (dir, store) = fresh();
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    let batch = store.pending.lock().open.clone();
    store.objects.write(&batch, || store.staging()).unwrap();
    std::mem::forget(store.staging().unwrap()); // a killed process removes nothing
    let other = again(&dir);
    assert_eq!(other.hit(&record.key).unwrap(), None);
    assert!(other.contains(&record.outputs["photos"].digest));
    other.put_record(record.clone());
    other.commit().unwrap();
    assert_eq!(again(&dir).hit(&record.key).unwrap(), Some(record));
}

#[test]
fn leftovers_of_the_dead_are_swept_and_those_of_the_living_stay() {
    let (dir, store) = fresh();
    let digest = store.put(&large(7)).unwrap();
    let dead = store.dir().join("tmp").join("0123456789abcdef");
    fs::create_dir(&dead).unwrap();
    fs::write(dead.join("alive"), b"").unwrap();
    fs::write(dead.join("half"), b"half a blob").unwrap();
    let other = again(&dir);
    assert!(!dead.exists());
    assert_eq!(store.get(&digest).unwrap().len(), 200_000);
    store.commit().unwrap();
    assert_eq!(other.get(&digest).unwrap().len(), 200_000);
}

#[test]
fn another_process_that_keeps_the_index_is_an_error_after_a_bounded_wait() {
    let (_dir, store) = fresh();
    store.put_record(record("k", &store, b"out"));
    store.commit().unwrap();
    let held = redb::Database::open(store.dir().join("index.redb")).unwrap();
    let index = Index::with_lock_timeout(store.dir(), Duration::from_millis(20));
    let error = index.record(&Digest::of(b"k")).unwrap_err();
    assert!(
        matches!(error, StoreError::Locked { waited_ms: 20.., .. }),
        "{error}"
    );
    drop(held);
    assert!(index.record(&Digest::of(b"k")).unwrap().is_some());
}

#[test]
fn eight_writers_on_one_folder_lose_nothing() {
    let (dir, _store) = fresh();
    std::thread::scope(|scope| {
        for writer in 0..8_u8 {
            let store = again(&dir);
            scope.spawn(move || {
                for round in 0..5_u8 {
                    let blob = [writer, round].repeat(40_000 * usize::from(round % 2) + 10);
                    store.put_record(record(&format!("{writer} {round}"), &store, &blob));
                    store.commit().unwrap();
                }
            });
        }
    });
    let store = again(&dir);
    let records = store.records().unwrap();
    assert_eq!(records.len(), 40);
    for record in records {
        store.get(&record.outputs["photos"].digest).unwrap();
    }
}

#[test]
fn runs_are_numbered_in_order_also_by_two_stores() {
    let (dir, store) = fresh();
    let other = again(&dir);
    assert_eq!(store.put_run(b"1").unwrap(), 1);
    assert_eq!(other.put_run(b"2").unwrap(), 2);
    assert_eq!(store.put_run(b"3").unwrap(), 3);
    assert_eq!(store.run_numbers().unwrap(), vec![1, 2, 3]);
    assert_eq!(store.run(2).unwrap(), b"2");
    assert!(store.run(4).is_err());
}

#[test]
fn the_count_of_a_store_is_exact() {
    let (_dir, store) = fresh();
    store.put(&large(9)).unwrap();
    store.put_record(record("k", &store, b"small"));
    store.put_memo(Digest::of(b"m"), Digest::of(b"small"));
    store.put_run(b"{}").unwrap();
    let stat = store.stat().unwrap();
    assert!(stat.index_bytes > 0);
    let expected = StoreStat {
        loose_blobs: 1,
        loose_bytes: 200_000,
        packs: 1,
        packed_blobs: 1,
        packed_bytes: 5,
        records: 1,
        memos: 1,
        runs: 1,
        quarantined: 0,
        index_bytes: stat.index_bytes,
    };
    assert_eq!(stat, expected);
}

#[test]
fn a_store_that_cannot_be_written_names_the_path() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("not-a-folder");
    fs::write(&file, b"").unwrap();
    let Err(error) = Store::open(file.join(".marf")) else {
        panic!("a file cannot hold a store");
    };
    assert!(error.to_string().contains("not-a-folder"), "{error}");
}
