//! One flipped bit, a cut, an emptying in every file of a store.

use proptest::prelude::*;

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_flipped_bit_is_quarantined_and_never_served(position in 0.0_f64..1.0, bit in 0_u8..8, seed in 1_u8..) {
        for blob in [large(seed), vec![seed; 3000]] {
            let (dir, store) = fresh();
            let digest = store.put(&blob).unwrap();
            store.commit().unwrap();
            let damaged = packs(&store).pop().unwrap_or_else(|| store.objects.loose_path(&digest));
            let mut bytes = fs::read(&damaged).unwrap();
            let payload = bytes.windows(blob.len()).position(|window| window == blob).unwrap();
            bytes[payload + (position * blob.len() as f64) as usize] ^= 1 << bit;
            replace(&damaged, &bytes);
            let error = store.get(&digest).unwrap_err();
            prop_assert!(matches!(error, StoreError::Damaged { .. }), "{}", error);
            prop_assert_eq!(error.lost(), Some(digest));
            prop_assert!(!store.contains(&digest), "still claimed");
            prop_assert!(!reopen(&dir).contains(&digest), "claimed after reopening");
            prop_assert_eq!(store.stat().unwrap().quarantined, 1);
            prop_assert_eq!(store.put(&blob).unwrap(), digest);
            store.commit().unwrap();
            prop_assert_eq!(&*reopen(&dir).get(&digest).unwrap(), blob.as_slice());
        }
    }
}

/// A damaged record or memo is a miss with a warning, and its neighbours in the pack stay.
#[test]
fn a_damaged_record_or_memo_is_a_miss_and_its_neighbours_stay() {
    for (at_end, kind) in [(false, "record"), (true, "memo")] {
        let (dir, store) = fresh();
        let record = record("k", &store, b"out");
        store.put_record(record.clone());
        let (memo, blob) = (Digest::from_content(b"m"), store.put(b"features").unwrap());
        store.put_memo(memo, blob, record.key);
        store.commit().unwrap();
        let pack = packs(&store).pop().unwrap();
        let mut bytes = fs::read(&pack).unwrap();
        let wanted = if at_end {
            [blob.as_bytes().as_slice(), record.key.as_bytes()].concat()
        } else {
            b"\"stage\":\"blur\"".to_vec()
        };
        let at = bytes
            .windows(wanted.len())
            .rposition(|window| window == wanted)
            .unwrap();
        bytes[at + 3] ^= 4;
        replace(&pack, &bytes);
        let found = (
            store.hit(&record.key).unwrap().is_some(),
            store.memo(&memo).unwrap().is_some(),
        );
        assert_eq!(found, (at_end, !at_end), "{kind}");
        assert!(store.get(&blob).is_ok(), "{kind}");
        let warnings = store.take_warnings();
        let key = if at_end { memo } else { record.key };
        let said = format!(
            "the {kind} of key {} was damaged and is in quarantine in `",
            key.short()
        );
        let warning = warnings.iter().find_map(|text| text.strip_prefix(&said));
        let file = warning
            .unwrap_or_else(|| panic!("{said}: {warnings:?}"))
            .trim_end_matches('`');
        assert!(Path::new(file).exists(), "{file}");
        assert_eq!(reopen(&dir).take_warnings(), Vec::<String>::new());
    }
}

fn copy(from: &Path, to: &Path) {
    for path in files_below(from) {
        let target = to.join(path.strip_prefix(from).unwrap());
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::copy(&path, &target).unwrap();
    }
}

/// Every file of a store, in turn: flipped bits at several places, cut in half, emptied, removed.
#[test]
fn whatever_file_is_damaged_nothing_false_is_served_and_the_store_stays_usable() {
    let (dir, store) = fresh();
    session::repeat(&store, "whole");
    let root = store.dir().to_owned();
    drop(store);
    let files: Vec<PathBuf> = files_below(&root)
        .iter()
        .map(|path| path.strip_prefix(&root).unwrap().to_owned())
        .collect();
    let places = super::rounds(12);
    for file in &files {
        let good = fs::read(root.join(file)).unwrap();
        let mut bad = vec![Some(good[..good.len() / 2].to_vec()), Some(Vec::new()), None];
        for place in 0..places.min(good.len()) {
            let mut bytes = good.clone();
            // Places spread over the file, each with another bit.
            let at = (place * good.len() + good.len() / 2) / places.min(good.len());
            bytes[at.min(good.len() - 1)] ^= 1 << (place % 8);
            bad.push(Some(bytes));
        }
        for (number, bytes) in bad.into_iter().enumerate() {
            let context = format!("{}, damage {number}", file.display());
            let copied = tempfile::tempdir().unwrap();
            copy(&root, &copied.path().join(".marf"));
            let path = copied.path().join(".marf").join(file);
            fs::remove_file(&path).unwrap();
            if let Some(bytes) = bytes {
                fs::write(&path, bytes).unwrap();
            }
            let store = again_unsynced(&copied);
            tolerant_check(&store, &context);
            session::repeat(&store, &context);
            session::repeat(&again_unsynced(&copied), &context);
        }
    }
    drop(dir);
}

/// As the check of a session, but a blob may turn out damaged when it is read.
fn tolerant_check(store: &Store, context: &str) {
    for number in 0..session::STEPS {
        let step = session::step(number);
        let Some(record) = store.hit(&step.action.key()).unwrap() else {
            continue;
        };
        assert_eq!(record, step.record(), "{context}");
        for output in record.outputs.values() {
            match store.get(&output.digest) {
                Ok(bytes) => assert_eq!(Digest::from_content(&bytes), output.digest, "{context}"),
                Err(error) => assert_eq!(error.lost(), Some(output.digest), "{context}: {error}"),
            }
            let bytes = store.size_of(&output.digest);
            assert!(
                bytes.is_none_or(|bytes| bytes == output.bytes),
                "{context}: {bytes:?}"
            );
        }
        if let Some(blob) = store.memo(&step.memo).unwrap() {
            match store.get(&blob) {
                Ok(bytes) => assert_eq!(&*bytes, step.memo_blob.as_slice(), "{context}"),
                Err(error) => assert_eq!(error.lost(), Some(blob), "{context}: {error}"),
            }
        }
    }
}

#[test]
fn a_check_finds_each_damage_names_what_it_breaks_and_repairs_it() {
    let (dir, store) = fresh();
    let small = record("small", &store, &[5; 3000]);
    let big = record("big", &store, &large(3));
    store.put_record(small.clone());
    store.put_record(big.clone());
    store.put_run(b"{\"first\":1}").unwrap();
    let options = FsckOptions {
        read_data: ReadShare::ALL,
        repair: false,
    };
    let whole = store.fsck(options).unwrap();
    assert_eq!(whole.faults, vec![]);
    assert_eq!((whole.blobs, whole.records, whole.runs), (4, 2, 1));
    let run = &files_below(&store.dir().join("runs"))[0];
    replace(run, b"{}");
    for (path, wanted) in [
        (packs(&store).remove(0), vec![5; 3000]),
        (store.objects.loose_path(&big.outputs["photos"].digest), large(3)),
    ] {
        let mut bytes = fs::read(&path).unwrap();
        let at = bytes
            .windows(wanted.len())
            .position(|window| window == wanted)
            .unwrap();
        bytes[at + 99] ^= 1;
        replace(&path, &bytes);
    }
    let report = store.fsck(options).unwrap();
    let broken: Vec<_> = report.faults.iter().map(|fault| fault.breaks.clone()).collect();
    assert_eq!(
        broken,
        [
            vec![("blur".to_owned(), big.key)],
            vec![("blur".to_owned(), small.key)],
            vec![]
        ],
        "{report:?}"
    );
    // Without a repair nothing is touched.
    assert_eq!(store.fsck(options).unwrap(), report);
    let repair = FsckOptions {
        repair: true,
        ..options
    };
    assert!(store.fsck(repair).unwrap().is_repaired);
    let warnings = store.take_warnings();
    let moved = warnings
        .iter()
        .find(|text| text.starts_with("a damaged pack was moved to `"));
    let moved = moved.unwrap_or_else(|| panic!("{warnings:?}"));
    // An output of each record, the two actions are in it or not: of all, the flipped one alone is not whole.
    let counts: Vec<usize> = moved.split(' ').filter_map(|word| word.parse().ok()).collect();
    let [whole, all] = counts[..] else {
        panic!("{moved}")
    };
    assert!(
        moved.ends_with(&format!("{whole} of its {all} objects are whole and stay")) && whole + 1 == all,
        "{moved}"
    );
    let after = reopen(&dir).fsck(options).unwrap();
    assert!(
        after
            .faults
            .iter()
            .all(|fault| fault.what.starts_with("a record names")),
        "{after:?}"
    );
    assert_eq!(after.faults.len(), 2);
    assert_eq!(store.hit(&small.key).unwrap(), None);
}

#[test]
fn a_check_ends_at_any_object_when_the_caller_wants_it() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    let (dir, store) = fresh();
    for seed in [3, 5] {
        store.put(&large(seed)).unwrap();
    }
    store.put_record(record("k", &store, b"out"));
    store.commit().unwrap();
    drop(store);
    let left = Arc::new(AtomicUsize::new(usize::MAX));
    let asked = Arc::clone(&left);
    let is_stopped = move || {
        asked
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1))
            .is_err()
    };
    let store = Store::open_interruptible(dir.path().join(".marf"), is_stopped).unwrap();
    let options = FsckOptions {
        read_data: ReadShare::ALL,
        repair: true,
    };
    // Two loose blobs, a pack with action, output and record, the record again, the repair.
    for objects in 0..7 {
        left.store(objects, Ordering::Relaxed);
        let ended = store.fsck(options);
        assert!(matches!(ended, Err(StoreError::Stopped)), "{objects}: {ended:?}");
    }
    left.store(7, Ordering::Relaxed);
    assert_eq!(store.fsck(options).unwrap().faults, vec![]);
}

#[test]
fn a_check_finds_a_false_row_of_the_index_and_repairs_it() {
    let (_dir, store) = fresh();
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    store.commit().unwrap();
    let other = rusqlite::Connection::open(store.dir().join("index.sqlite")).unwrap();
    other
        .execute("UPDATE object SET offset = offset + 1", [])
        .unwrap();
    drop(other);
    let mut options = FsckOptions::default();
    assert_eq!(store.fsck(options).unwrap().faults.len(), 3);
    options.repair = true;
    store.fsck(options).unwrap();
    options.repair = false;
    assert_eq!(store.fsck(options).unwrap().faults, vec![]);
    assert_eq!(store.hit(&record.key).unwrap(), Some(record));
}
