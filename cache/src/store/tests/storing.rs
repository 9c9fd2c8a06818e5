//! Stored objects come back, once, in order, and counted.

use proptest::prelude::*;

use super::*;

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
        let other = reopen(&dir);
        for (digest, blob) in digests.iter().zip(&blobs) {
            prop_assert_eq!(&*store.get(digest).unwrap(), blob.as_slice());
            prop_assert_eq!(&*other.get(digest).unwrap(), blob.as_slice());
            prop_assert_eq!(other.size_of(digest), Some(blob.len() as u64));
        }
    }
}

#[test]
fn a_record_is_seen_at_once_here_and_after_a_commit_elsewhere() {
    let (dir, store) = fresh();
    let other = reopen(&dir);
    let record = record("k", &store, b"out");
    store.put_record(record.clone());
    assert_eq!(store.hit(&record.key).unwrap().as_ref(), Some(&record));
    assert_eq!(other.hit(&record.key).unwrap(), None);
    store.commit().unwrap();
    assert_eq!(other.hit(&record.key).unwrap().as_ref(), Some(&record));
    assert_eq!(reopen(&dir).records().unwrap(), vec![record]);
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
    let expected = Conflict {
        key: first.key,
        stage: "blur".into(),
        kept: first.outputs,
        refused: second.outputs,
        replaced: false,
    };
    assert_eq!(store.take_conflicts(), vec![expected]);
    assert_eq!(store.take_conflicts(), vec![]);
}

/// A second, different result of a stage is reported as a conflict, even if the first result is lost.
#[test]
fn a_record_whose_output_is_gone_is_a_miss_and_its_different_successor_a_conflict() {
    let (dir, store) = fresh();
    let first = record("k", &store, &large(3));
    store.put_record(first.clone());
    store.commit().unwrap();
    fs::remove_file(store.objects.loose_path(&first.outputs["photos"].digest)).unwrap();
    assert_eq!(store.hit(&first.key).unwrap(), None);
    let second = record("k", &store, &large(5));
    store.put_record(second.clone());
    store.commit().unwrap();
    assert_eq!(reopen(&dir).hit(&first.key).unwrap().as_ref(), Some(&second));
    let expected = Conflict {
        key: first.key,
        stage: "blur".into(),
        kept: second.outputs.clone(),
        refused: first.outputs,
        replaced: true,
    };
    assert_eq!(store.take_conflicts(), vec![expected]);
    // The rebuilt index keeps the successor too.
    store.objects.index.rebuild("a test").unwrap();
    assert_eq!(store.hit(&second.key).unwrap(), Some(second));
}

#[test]
fn the_same_result_made_again_for_a_lost_output_is_no_conflict() {
    let (_dir, store) = fresh();
    let first = record("k", &store, &large(3));
    store.put_record(first.clone());
    store.commit().unwrap();
    fs::remove_file(store.objects.loose_path(&first.outputs["photos"].digest)).unwrap();
    store.put_record(record("k", &store, &large(3)));
    store.commit().unwrap();
    assert_eq!(store.hit(&first.key).unwrap(), Some(first));
    assert_eq!(store.take_conflicts(), vec![]);
}

#[test]
fn two_processes_that_finish_one_key_differently_keep_one_and_tell_it() {
    let (dir, store) = fresh();
    let other = reopen(&dir);
    let (first, second) = (record("k", &store, b"one"), record("k", &other, b"two"));
    store.put_record(first.clone());
    other.put_record(second.clone());
    store.commit().unwrap();
    other.commit().unwrap();
    assert_eq!(other.hit(&first.key).unwrap().unwrap().outputs, first.outputs);
    assert_eq!(other.take_conflicts().len(), 1);
}

#[test]
fn a_memo_may_be_replaced_and_without_its_blob_is_none() {
    let (dir, store) = fresh();
    let (key, maker) = (Digest::from_content(b"memo"), Digest::from_content(b"maker"));
    for text in [b"one".as_slice(), b"two", b"one"] {
        let blob = store.put(text).unwrap();
        store.put_memo(key, blob, maker);
        assert_eq!(store.memo(&key).unwrap(), Some(blob));
        store.commit().unwrap();
        assert_eq!(reopen(&dir).memo(&key).unwrap(), Some(blob));
        store.objects.index.rebuild("a test").unwrap();
        assert_eq!(store.memo(&key).unwrap(), Some(blob));
    }
    store.put_memo(key, Digest::from_content(b"never stored"), maker);
    assert_eq!(store.memo(&key).unwrap(), None);
}

#[test]
fn leftovers_of_the_dead_are_swept_and_those_of_the_living_stay() {
    let (dir, store) = fresh();
    let digest = store.put(&large(7)).unwrap();
    let dead = store.dir().join("tmp").join("0123456789abcdef");
    fs::create_dir(&dead).unwrap();
    fs::write(dead.join("alive"), b"").unwrap();
    fs::write(dead.join("half"), b"half a blob").unwrap();
    let other = reopen(&dir);
    assert!(!dead.exists());
    assert_eq!(store.get(&digest).unwrap().len(), 200_000);
    store.commit().unwrap();
    assert_eq!(other.get(&digest).unwrap().len(), 200_000);
}

#[test]
fn a_file_is_stored_as_its_bytes_were_and_not_linked() {
    let (dir, store) = fresh();
    for bytes in [b"small".to_vec(), large(3)] {
        let path = dir.path().join("photo");
        fs::write(&path, &bytes).unwrap();
        let (digest, read) = store.put_file(&path, 1 << 20).unwrap();
        assert_eq!((digest, &*read), (Digest::from_content(&bytes), bytes.as_slice()));
        fs::write(&path, b"edited in place").unwrap();
        store.commit().unwrap();
        assert_eq!(&*reopen(&dir).get(&digest).unwrap(), bytes.as_slice());
    }
}

#[test]
fn a_reference_is_read_where_it_lies_and_is_damaged_when_it_is_edited() {
    let (dir, store) = fresh();
    let path = dir.path().join("photo");
    for bytes in [b"small".to_vec(), large(3)] {
        fs::write(&path, &bytes).unwrap();
        let (digest, read) = store.put_reference(&path, 1 << 20).unwrap();
        store.commit().unwrap();
        assert_eq!((digest, &*read), (Digest::from_content(&bytes), bytes.as_slice()));
        let link = store.objects.loose_path(&digest);
        assert_eq!(fs::read_link(&link).unwrap(), fs::canonicalize(&path).unwrap());
        assert_eq!(&*reopen(&dir).get(&digest).unwrap(), bytes.as_slice());
        let stat = store.stat().unwrap();
        let outside = (stat.references, stat.referenced_bytes);
        assert_eq!((outside, stat.loose_blobs), ((1, bytes.len() as u64), 0));
        // The bytes outside are nobody's but the user's: they are neither sealed nor moved.
        fs::write(&path, b"edited in place").unwrap();
        let error = store.get(&digest).unwrap_err();
        assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
        assert!(matches!(store.get(&digest), Err(StoreError::Missing { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"edited in place");
        assert!(fs::read_link(&link).is_err());
    }
}

#[test]
fn a_reference_to_a_file_that_is_gone_is_lost_and_can_be_stored_again() {
    let (dir, store) = fresh();
    let path = dir.path().join("photo");
    fs::write(&path, large(3)).unwrap();
    let (digest, _) = store.put_reference(&path, 1 << 20).unwrap();
    store.commit().unwrap();
    fs::remove_file(&path).unwrap();
    assert!(!store.contains(&digest));
    assert!(matches!(store.get(&digest), Err(StoreError::Missing { .. })));
    assert_eq!(store.put(&large(3)).unwrap(), digest);
    store.commit().unwrap();
    assert_eq!(&*reopen(&dir).get(&digest).unwrap(), large(3).as_slice());
    assert!(store.put_reference(&path, 1 << 20).is_err());
}

/// A pipe would block and a device would fill the memory.
#[test]
#[cfg(unix)]
fn a_reference_to_what_is_no_regular_file_any_more_is_damaged() {
    let (dir, store) = fresh();
    let path = dir.path().join("photo");
    fs::write(&path, large(3)).unwrap();
    let (digest, _) = store.put_reference(&path, 1 << 20).unwrap();
    store.commit().unwrap();
    let loose = store.objects.loose_path(&digest);
    let made = std::process::Command::new("mkfifo")
        .arg(dir.path().join("pipe"))
        .status();
    assert!(made.unwrap().success());
    for device in ["/dev/zero", "pipe"].map(|name| dir.path().join(name)) {
        let _ = fs::remove_file(&loose);
        std::os::unix::fs::symlink(&device, &loose).unwrap();
        assert_eq!(store.objects.peek(&digest, 9).unwrap(), Some(Vec::new()));
        let options = FsckOptions {
            read_data: ReadShare::ALL,
            repair: false,
        };
        let faults = store.fsck(options).unwrap().faults;
        assert_eq!((faults.len(), faults[0].object), (1, Some(digest)), "{faults:?}");
        assert!(store.put_reference(&device, 1 << 20).is_err());
        assert!(matches!(store.get(&digest), Err(StoreError::Damaged { .. })));
        assert!(matches!(store.get(&digest), Err(StoreError::Missing { .. })));
    }
}

#[test]
fn a_file_above_the_limit_is_refused_with_both_numbers() {
    let (dir, store) = fresh();
    let path = dir.path().join("photo");
    fs::write(&path, large(3)).unwrap();
    let error = store.put_file(&path, 199_999).unwrap_err();
    assert!(
        matches!(
            error,
            StoreError::TooLarge {
                bytes: 200_000,
                max_bytes: 199_999,
                ..
            }
        ),
        "{error}"
    );
    assert!(store.put_file(&path, 200_000).is_ok());
    assert!(store.put_file(&dir.path().join("absent"), 1).is_err());
}

#[test]
fn eight_writers_on_one_folder_lose_nothing() {
    let (dir, _store) = fresh();
    std::thread::scope(|scope| {
        for writer in 0..8_u8 {
            let store = reopen(&dir);
            scope.spawn(move || {
                for round in 0..12_u8 {
                    let blob = [writer, round].repeat(40_000 * usize::from(round % 2) + 10);
                    store.put_record(record(&format!("{writer} {round}"), &store, &blob));
                    store.commit().unwrap();
                }
            });
        }
    });
    let store = reopen(&dir);
    let records = store.records().unwrap();
    assert_eq!(records.len(), 96);
    for record in records {
        store.get(&record.outputs["photos"].digest).unwrap();
    }
}

/// Another program created it between this one's look at the folder and its own file `format`.
#[test]
fn a_store_that_another_program_has_just_created_keeps_its_form() {
    let (dir, store) = fresh();
    let files = Files::of_disk();
    let notices = Notices::default();
    open::prepare(store.dir(), &files, format::StoreForm::Nothing, &notices).unwrap();
    assert!(!store.dir().join("bad").exists());
    assert_eq!(reopen(&dir).take_warnings(), [""; 0]);
}

/// Every commit makes a pack. At rest no tier has eight, and the merges lose nothing.
#[test]
fn many_small_packs_are_merged_and_keep_every_object() {
    let (dir, store) = fresh();
    let reader = reopen(&dir);
    let mut digests = Vec::new();
    for round in 0..100_u32 {
        digests.push(store.put(&round.to_le_bytes()).unwrap());
        store.commit().unwrap();
        assert!(packs(&store).len() <= 8, "round {round}");
        // A reader that knows the places in packs that are gone finds the new ones.
        assert!(reader.get(&digests[0]).is_ok());
    }
    for store in [&store, &reader, &reopen(&dir)] {
        for (round, digest) in (0_u32..).zip(&digests) {
            assert_eq!(&*store.get(digest).unwrap(), &round.to_le_bytes());
        }
    }
    store.objects.index.rebuild("a test").unwrap();
    assert!(digests.iter().all(|digest| store.get(digest).is_ok()));
}

/// Another program merges it: its file goes between two reads.
#[test]
fn a_pack_that_is_removed_while_it_is_read_is_gone_and_never_damaged() {
    let (dir, store) = fresh();
    store.put(b"small").unwrap();
    store.commit().unwrap();
    let bytes = fs::read(&packs(&store)[0]).unwrap();
    for round in 0..500 {
        let path = dir.path().join(format!("{round}.pack"));
        fs::write(&path, &bytes).unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while let Some(contents) = crate::store::pack::contents(&store.objects.files, &path).unwrap()
                {
                    assert!(contents.has_table, "round {round}");
                }
            });
            std::thread::yield_now();
            fs::remove_file(&path).unwrap();
        });
    }
}

#[test]
fn runs_are_numbered_in_order_also_by_two_stores() {
    let (dir, store) = fresh();
    let other = reopen(&dir);
    assert_eq!(store.put_run(b"1").unwrap(), 1);
    assert_eq!(other.put_run(b"2").unwrap(), 2);
    assert_eq!(store.put_run(b"3").unwrap(), 3);
    assert_eq!(store.run_numbers().unwrap(), vec![1, 2, 3]);
    assert_eq!(store.run(2).unwrap(), b"2");
    assert!(matches!(store.run(4), Err(StoreError::NoRun { number: 4 })));
    store.remove_run(2).unwrap();
    store.remove_run(2).unwrap();
    assert_eq!(store.run_numbers().unwrap(), vec![1, 3]);
}

#[test]
fn one_damaged_run_root_is_an_error_of_that_run_only() {
    let (_dir, store) = fresh();
    for text in [b"first".as_slice(), b"second", b"third"] {
        store.put_run(text).unwrap();
    }
    replace(&files_below(&store.dir().join("runs"))[2], b"thirt");
    let error = store.run(3).unwrap_err();
    assert!(
        matches!(error, StoreError::DamagedRun { number: 3, .. }),
        "{error}"
    );
    assert_eq!(store.run_numbers().unwrap(), vec![1, 2]);
    assert_eq!(store.run(2).unwrap(), b"second");
    assert!(matches!(store.run(3), Err(StoreError::NoRun { .. })));
}

#[test]
fn the_count_of_a_store_is_exact() {
    let (_dir, store) = fresh();
    store.put(&large(9)).unwrap();
    let record = record("k", &store, b"small");
    let action_bytes = action("blur", "k", &[]).encode().len() as u64;
    store.put_record(record);
    store.put_memo(
        Digest::from_content(b"m"),
        Digest::from_content(b"small"),
        Digest::from_content(b"maker"),
    );
    store.put_run(b"{}").unwrap();
    let stat = store.stat().unwrap();
    assert!(stat.index_bytes > 0);
    let expected = StoreStat {
        references: 0,
        referenced_bytes: 0,
        loose_blobs: 1,
        loose_bytes: 200_000,
        packs: 1,
        packed_blobs: 2,
        packed_bytes: 5 + action_bytes,
        records: 1,
        memos: 1,
        runs: 1,
        quarantined: 0,
        index_bytes: stat.index_bytes,
    };
    assert_eq!(stat, expected);
    let by_stage = store.stat_by_stage().unwrap();
    let expected = StageStat {
        records: 1,
        outputs: 1,
        bytes: 5,
    };
    assert_eq!(by_stage, BTreeMap::from([("blur".to_owned(), expected)]));
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

#[test]
fn a_later_form_is_refused_and_a_damaged_form_is_not_taken_for_one() {
    let (dir, store) = fresh();
    let digest = store.put(b"kept").unwrap();
    store.commit().unwrap();
    let path = store.dir().join("format");
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.starts_with("marf store 2\n"), "{text}");
    drop(store);
    replace(&path, b"marf store 3\n");
    let Err(error) = Store::open(path.parent().unwrap()) else {
        panic!("a later form was opened");
    };
    assert!(
        matches!(
            error,
            StoreError::Newer {
                found: 3,
                known: 2,
                ..
            }
        ),
        "{error}"
    );
    replace(&path, text.replace('2', "3").as_bytes());
    let store = reopen(&dir);
    assert!(store.get(&digest).is_ok());
    assert_eq!(store.take_warnings().len(), 1);
    assert_eq!(fs::read_to_string(&path).unwrap(), text);
}
