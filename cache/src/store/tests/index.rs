//! The index may be damaged or lost: only the packs decide which objects exist.

use std::time::Duration;

use rusqlite::Connection;

use super::*;

fn index(store: &Store) -> PathBuf {
    store.dir().join("index.sqlite")
}

/// Findings row H: a computed result is never dropped because another program keeps the index.
#[test]
fn a_locked_index_delays_the_rows_of_a_result_and_never_drops_it() {
    let (dir, store) = fresh();
    store.put_record(record("first", &store, b"one"));
    store.commit().unwrap();
    let holder = Connection::open(index(&store)).unwrap();
    holder.execute_batch("BEGIN IMMEDIATE").unwrap();
    store.objects.index.set_patience(Duration::ZERO);
    let mut records = Vec::new();
    for name in ["second", "third"] {
        let record = record(name, &store, name.as_bytes());
        store.put_record(record.clone());
        store.commit().unwrap();
        assert_eq!(store.hit(&record.key).unwrap().as_ref(), Some(&record));
        records.push(record);
    }
    let warnings = store.take_warnings();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains("keeps the index"), "{warnings:?}");
    drop(holder);
    let other = reopen(&dir);
    for record in &records {
        assert_eq!(other.hit(&record.key).unwrap().as_ref(), Some(record));
    }
    // The writer itself brings the index up to date at its next commit.
    store.put(b"more").unwrap();
    store.commit().unwrap();
    assert_eq!(other.objects.index.segments().unwrap().len(), 4);
}

#[test]
fn a_wait_for_the_index_ends_when_the_caller_wants_it() {
    let (dir, first) = fresh();
    drop(first);
    let store = Store::open_interruptible(dir.path().join(".marf"), || true).unwrap();
    let holder = Connection::open(index(&store)).unwrap();
    holder.execute_batch("BEGIN IMMEDIATE").unwrap();
    store.objects.index.set_patience(Duration::from_secs(3600));
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    store.commit().unwrap();
    assert_eq!(store.hit(&record.key).unwrap(), Some(record));
}

/// Packs appear without their rows when a process dies between the two.
#[test]
fn a_pack_without_rows_is_found_by_a_store_that_is_open_and_by_one_that_opens() {
    let (dir, store) = fresh();
    let reader = reopen(&dir);
    let holder = Connection::open(index(&store)).unwrap();
    holder.execute_batch("BEGIN IMMEDIATE").unwrap();
    store.objects.index.set_patience(Duration::ZERO);
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    store.commit().unwrap();
    drop(store);
    drop(holder);
    assert_eq!(reader.hit(&record.key).unwrap().as_ref(), Some(&record));
    assert_eq!(reopen(&dir).hit(&record.key).unwrap(), Some(record));
}

#[test]
fn readers_do_not_wait_for_a_writer() {
    let (dir, store) = fresh();
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    store.commit().unwrap();
    let writer = Connection::open(index(&store)).unwrap();
    writer
        .execute_batch("BEGIN IMMEDIATE; DELETE FROM object; DELETE FROM segment")
        .unwrap();
    assert_eq!(store.hit(&record.key).unwrap().as_ref(), Some(&record));
    assert_eq!(reopen(&dir).hit(&record.key).unwrap(), Some(record));
}

#[test]
fn an_index_that_is_damaged_at_open_is_moved_away_and_made_from_the_packs() {
    let (dir, store) = fresh();
    let kept = record("k", &store, b"out");
    store.put_record(kept.clone());
    store.commit().unwrap();
    let (path, root) = (index(&store), store.dir().to_owned());
    drop(store);
    let good = fs::read(&path).unwrap();
    let half = &good[..good.len() / 2];
    let garbage = vec![0x5A; 5000];
    for (round, bytes) in [&[], half, &good[..100], &garbage].into_iter().enumerate() {
        fs::write(&path, bytes).unwrap();
        let store = reopen(&dir);
        assert_eq!(
            store.hit(&kept.key).unwrap().as_ref(),
            Some(&kept),
            "round {round}"
        );
        assert_eq!(store.take_warnings().len(), 1, "round {round}");
        let bad = files_below(&root.join("bad"));
        assert!(bad.len() > round, "round {round}: {bad:?}");
    }
}

#[test]
fn an_index_that_is_damaged_or_removed_in_the_middle_of_a_run_is_made_anew() {
    let (dir, store) = fresh();
    let reader = reopen(&dir);
    let mut records = Vec::new();
    for round in 0..4 {
        let record = record(&round.to_string(), &store, &[round; 50]);
        store.put_record(record.clone());
        store.commit().unwrap();
        records.push(record);
        match round {
            0 => fs::remove_file(index(&store)).unwrap(),
            1 => fs::write(index(&store), vec![7; 9000]).unwrap(),
            2 => replace(&index(&store), b""),
            _ => {}
        }
        for store in [&store, &reader] {
            for record in &records {
                assert_eq!(
                    store.hit(&record.key).unwrap().as_ref(),
                    Some(record),
                    "round {round}"
                );
            }
        }
    }
    assert_eq!(reopen(&dir).records().unwrap().len(), 4);
}

#[test]
fn a_pack_that_is_gone_takes_its_rows_along_and_nothing_else() {
    let (dir, store) = fresh();
    let first = store.put(b"first").unwrap();
    store.commit().unwrap();
    let gone = packs(&store);
    let second = store.put(b"second").unwrap();
    store.commit().unwrap();
    fs::remove_file(&gone[0]).unwrap();
    for store in [&store, &reopen(&dir)] {
        assert!(matches!(store.get(&first), Err(StoreError::Missing { .. })));
        assert!(!store.contains(&first));
        assert!(store.get(&second).is_ok());
    }
    assert_eq!(store.put(b"first").unwrap(), first);
    store.commit().unwrap();
    assert!(reopen(&dir).get(&first).is_ok());
}

/// A bit of the index that makes a place false is noticed at the place.
#[test]
fn a_false_place_in_the_index_is_never_served() {
    let (_dir, store) = fresh();
    let (one, two) = (store.put(b"one").unwrap(), store.put(b"two").unwrap());
    store.commit().unwrap();
    let other = Connection::open(index(&store)).unwrap();
    for change in [
        "offset = offset + 1",
        "len = 2",
        "len = 1000000",
        "segment = 77",
        "offset = -9",
    ] {
        other.execute_batch(&format!("UPDATE object SET {change}")).ok();
        assert_eq!(store.size_of(&one), Some(3), "{change}");
        assert_eq!(&*store.get(&one).unwrap(), b"one", "{change}");
        assert_eq!(&*store.get(&two).unwrap(), b"two", "{change}");
    }
}

/// Findings row P: a store without permission to write is read without a write.
#[test]
#[cfg(unix)]
fn a_read_only_store_is_read_without_a_write_and_refuses_a_commit() {
    use std::os::unix::fs::PermissionsExt;
    let (dir, store) = fresh();
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    store.put_run(b"{}").unwrap();
    let root = store.dir().to_owned();
    // The last pack is not in the index, as after a crash.
    let holder = Connection::open(index(&store)).unwrap();
    holder.execute_batch("BEGIN IMMEDIATE").unwrap();
    store.objects.index.set_patience(Duration::ZERO);
    let late = store.put(b"late").unwrap();
    store.commit().unwrap();
    drop((store, holder));
    let chmod = |mode: u32| {
        for path in files_below(&root).into_iter().chain([root.clone()]) {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        }
    };
    chmod(0o555);
    let before: Vec<_> = files_below(&root)
        .into_iter()
        .map(|path| (fs::read(&path).unwrap(), path))
        .collect();
    let store = reopen(&dir);
    assert!(store.is_read_only());
    assert_eq!(store.hit(&record.key).unwrap(), Some(record));
    assert_eq!(&*store.get(&late).unwrap(), b"late");
    assert_eq!(store.run(1).unwrap(), b"{}");
    assert_eq!(store.put(b"late").unwrap(), late);
    store.commit().unwrap();
    store.put(b"new").unwrap();
    let error = store.commit().unwrap_err();
    assert!(error.hint().unwrap().contains("--store"), "{error}");
    assert_eq!(store.take_warnings(), Vec::<String>::new());
    drop(store);
    let after: Vec<_> = files_below(&root)
        .into_iter()
        .map(|path| (fs::read(&path).unwrap(), path))
        .collect();
    assert!(before == after, "a file of the store changed");
    chmod(0o755);
}

/// Others merge and collect packs, and the index that they write cannot be read whole without a write.
#[test]
#[cfg(unix)]
fn a_read_only_store_finds_what_is_in_packs_that_replaced_those_of_its_index() {
    use std::os::unix::fs::PermissionsExt;
    let (dir, store) = fresh();
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    store.commit().unwrap();
    let root = store.dir().to_owned();
    drop(store);
    let replace_pack = |name: &str| {
        let packs = files_below(&root.join("packs"));
        assert_eq!(packs.len(), 1);
        fs::rename(&packs[0], root.join("packs").join(name)).unwrap();
    };
    let chmod = |mode| fs::set_permissions(&root, fs::Permissions::from_mode(mode)).unwrap();
    let find = |store: &Store| {
        assert!(store.is_read_only());
        assert_eq!(store.hit(&record.key).unwrap().as_ref(), Some(&record));
        assert_eq!(&*store.get(&record.outputs["photos"].digest).unwrap(), b"out");
    };
    chmod(0o555);
    let store = reopen(&dir);
    find(&store);
    replace_pack("second.pack");
    find(&store);
    replace_pack("third.pack");
    find(&store);
    find(&reopen(&dir));
    chmod(0o755);
}

/// A row whose segment is in no table leads nowhere, although a pack has the object.
#[test]
fn a_row_without_its_segment_is_found_and_the_index_made_anew() {
    let (dir, store) = fresh();
    let blob = store.put(b"one").unwrap();
    store.commit().unwrap();
    let connection = Connection::open(index(&store)).unwrap();
    connection
        .execute("UPDATE object SET segment = segment + 64", [])
        .unwrap();
    drop((connection, store));
    let store = reopen(&dir);
    assert!(!store.contains(&blob));
    let repair = FsckOptions {
        repair: true,
        ..FsckOptions::default()
    };
    let report = store.fsck(repair).unwrap();
    let told: Vec<_> = report
        .faults
        .iter()
        .map(|fault| (fault.object, fault.what))
        .collect();
    assert_eq!(told, [(Some(blob), "the index names a place without the object")]);
    assert_eq!(&*store.get(&blob).unwrap(), b"one");
}
