//! A folder as a shared store: what comes back, and what happens to bad objects.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::{
    path::PathBuf,
    sync::atomic::AtomicBool,
    time::{Duration, SystemTime},
};

use common::{Quiet, World, result, run_in};
use marf_cache::{Digest, ReadShare, Store};
use marf_remote::{FsckOptions, GcOptions, RemoteError, RemoteRun};

#[test]
fn what_was_pushed_comes_back_with_all_it_consists_of() {
    let world = World::new();
    let (here, there) = (world.store("here"), world.store("there"));
    let run = run_in(&here);
    let pushed = world.remote().push(&here, &run, &Quiet::default()).unwrap();
    assert_eq!((pushed.records, pushed.known_records, pushed.packs), (5, 0, 1));
    assert!(pushed.conflicts.is_empty());

    let remote = world.remote();
    let runs = remote.runs(Some("mars"), &Quiet::default()).unwrap();
    let root = Digest::from_content(run.root.as_bytes());
    assert_eq!(runs, vec![(1_700_000_000, root)]);
    assert_eq!(remote.runs(Some("venus"), &Quiet::default()).unwrap(), vec![]);
    let found = remote.run(&root, &Quiet::default()).unwrap();
    assert_eq!(found, run);
    let pulled = remote.pull(&there, &found, &Quiet::default()).unwrap();
    assert_eq!((pulled.records, pulled.blobs), (5, pushed.blobs));
    assert_eq!(pulled.blob_bytes, pushed.blob_bytes);

    let closure = |store: &Store| store.closure(&run.keys, &run.blobs).unwrap();
    assert_eq!(closure(&here), closure(&there));
    assert_eq!(closure(&there).missing, vec![]);
    for key in &run.keys {
        assert_eq!(here.record(key).unwrap(), there.record(key).unwrap());
    }
}

#[test]
fn a_second_push_or_pull_moves_nothing() {
    let world = World::new();
    let (here, there) = (world.store("here"), world.store("there"));
    let run = run_in(&here);
    world.remote().push(&here, &run, &Quiet::default()).unwrap();
    let again = world.remote().push(&here, &run, &Quiet::default()).unwrap();
    assert_eq!((again.records, again.known_records), (0, 2));
    assert_eq!((again.blobs, again.packs), (0, 0));
    world.remote().pull(&there, &run, &Quiet::default()).unwrap();
    let again = world.remote().pull(&there, &run, &Quiet::default()).unwrap();
    assert_eq!((again.records, again.known_records, again.blobs), (0, 5, 0));
}

#[test]
fn a_push_that_was_cut_short_is_finished_by_the_next() {
    let world = World::new();
    let (here, there) = (world.store("here"), world.store("there"));
    let run = run_in(&here);
    world.remote().push(&here, &run, &Quiet::default()).unwrap();
    // As if it had ended before its records, and before the index of its pack.
    std::fs::remove_dir_all(world.folder().join("records")).unwrap();
    std::fs::remove_dir_all(world.folder().join("runs")).unwrap();
    std::fs::remove_file(&world.files("packs", ".idx")[0]).unwrap();
    std::fs::remove_file(&world.files("cas", "")[0]).unwrap();
    let again = world.remote().push(&here, &run, &Quiet::default()).unwrap();
    assert_eq!((again.records, again.packs), (5, 1));
    let pulled = world.remote().pull(&there, &run, &Quiet::default()).unwrap();
    assert_eq!(pulled.records, 5);
    assert_eq!(there.closure(&run.keys, &run.blobs).unwrap().missing, vec![]);
}

#[test]
fn an_object_that_is_cut_or_altered_is_named_and_nothing_of_it_is_stored() {
    for (folder, ending) in [
        ("cas", ""),
        ("packs", ".pack"),
        ("packs", ".idx"),
        ("records", ""),
    ] {
        for cut in [false, true] {
            let world = World::new();
            let here = world.store("here");
            let run = run_in(&here);
            world.remote().push(&here, &run, &Quiet::default()).unwrap();
            let path = world.files(folder, ending)[0].clone();
            let mut bytes = std::fs::read(&path).unwrap();
            if cut {
                bytes.truncate(bytes.len() / 2)
            } else {
                bytes[5] ^= 1
            }
            std::fs::write(&path, bytes).unwrap();
            let there = world.store("there");
            let error = world.remote().pull(&there, &run, &Quiet::default()).unwrap_err();
            let text = error.to_string();
            assert!(
                text.contains("damaged") || text.contains("cannot read"),
                "{folder}{ending}: {text}"
            );
            assert!(text.contains(folder), "{text}");
            assert!(text.contains("file://"), "{text}");
            assert!(error.hint().is_some());
            for key in &run.keys {
                assert_eq!(there.record(key).unwrap(), None, "{folder}{ending}");
            }
        }
    }
}

#[test]
fn an_object_that_is_gone_is_told_with_its_digest() {
    let world = World::new();
    let (here, there) = (world.store("here"), world.store("there"));
    let run = run_in(&here);
    world.remote().push(&here, &run, &Quiet::default()).unwrap();
    std::fs::remove_file(&world.files("cas", "")[0]).unwrap();
    let error = world.remote().pull(&there, &run, &Quiet::default()).unwrap_err();
    assert!(
        matches!(error, RemoteError::Missing { what: "blob", .. }),
        "{error}"
    );
}

#[test]
fn a_second_different_result_is_a_conflict_and_the_first_stays() {
    let world = World::new();
    let (first, second, third) = (world.store("first"), world.store("second"), world.store("third"));
    let mut run = run_in(&first);
    run.keys = vec![result(&first, "same key", b"one result", &[], &[])];
    let other = RemoteRun {
        keys: vec![result(&second, "same key", b"another result", &[], &[])],
        blobs: Vec::new(),
        ..run.clone()
    };
    world.remote().push(&first, &run, &Quiet::default()).unwrap();
    let pushed = world.remote().push(&second, &other, &Quiet::default()).unwrap();
    let [conflict] = pushed.conflicts.as_slice() else {
        panic!("{:?}", pushed.conflicts);
    };
    assert_eq!(conflict.kept["out"].digest, Digest::from_content(b"one result"));
    assert_eq!(
        conflict.refused["out"].digest,
        Digest::from_content(b"another result")
    );
    world.remote().pull(&third, &run, &Quiet::default()).unwrap();
    let kept = third.record(&run.keys[0]).unwrap().unwrap();
    assert_eq!(kept.outputs["out"].digest, Digest::from_content(b"one result"));
}

#[test]
fn two_pushes_at_once_leave_one_whole_store() {
    let world = World::new();
    let stores = [world.store("one"), world.store("two")];
    let runs = stores.each_ref().map(run_in);
    assert_eq!(runs[0], runs[1], "the same results on two machines");
    std::thread::scope(|scope| {
        for (store, run) in stores.iter().zip(&runs) {
            let remote = world.remote();
            scope.spawn(move || {
                let pushed = remote.push(store, run, &Quiet::default()).unwrap();
                assert_eq!(pushed.conflicts, vec![]);
            });
        }
    });
    let there = world.store("there");
    world.remote().pull(&there, &runs[0], &Quiet::default()).unwrap();
    assert_eq!(
        there.closure(&runs[0].keys, &runs[0].blobs).unwrap().missing,
        vec![]
    );
    assert_eq!(
        world.files("leases", ""),
        Vec::<PathBuf>::new(),
        "all leases have ended"
    );
}

#[test]
fn what_is_no_shared_store_or_a_later_one_is_refused() {
    let world = World::new();
    let here = world.store("here");
    let error = world.remote().runs(None, &Quiet::default()).unwrap_err();
    assert!(matches!(error, RemoteError::Absent { .. }), "{error}");
    std::fs::write(world.folder().join("format"), "marf shared store 2\n").unwrap();
    let run = run_in(&here);
    let error = world.remote().push(&here, &run, &Quiet::default()).unwrap_err();
    assert!(matches!(error, RemoteError::Newer { .. }), "{error}");
    std::fs::write(world.folder().join("format"), "photos of my cat").unwrap();
    let error = world.remote().runs(None, &Quiet::default()).unwrap_err();
    assert!(matches!(error, RemoteError::Damaged { .. }), "{error}");
}

#[test]
fn a_push_that_is_stopped_leaves_no_lease() {
    let world = World::new();
    let here = world.store("here");
    let run = run_in(&here);
    let stopped = Quiet {
        stop: AtomicBool::new(true),
    };
    // It may end before the first look at the wish to stop.
    let ended = world.remote().push(&here, &run, &stopped);
    assert!(matches!(ended, Ok(_) | Err(RemoteError::Stopped)), "{ended:?}");
    assert_eq!(world.files("leases", ""), Vec::<PathBuf>::new());
}

/// A collection without grace, of everything that is not needed.
const AT_ONCE: GcOptions = GcOptions {
    keep_last: 1,
    grace: Duration::ZERO,
    dry_run: false,
};

/// Pushes two runs of one pipeline. The second has one result of its own and lacks one of the first.
fn two_runs(world: &World) -> (Store, RemoteRun) {
    let here = world.store("here");
    let first = run_in(&here);
    world.remote().push(&here, &first, &Quiet::default()).unwrap();
    let mut second = first.clone();
    second.started_unix_s += 1;
    second.root = "{\"pipeline\":\"mars\",\"second\":true}".to_owned();
    second.keys.pop();
    second.keys.push(result(&here, "new", b"n", &[], &[]));
    world.remote().push(&here, &second, &Quiet::default()).unwrap();
    (here, second)
}

#[test]
fn a_collection_removes_what_only_older_runs_need() {
    let world = World::new();
    let (_, second) = two_runs(&world);
    let would = GcOptions {
        dry_run: true,
        ..AT_ONCE
    };
    let would = world.remote().gc(would, &Quiet::default()).unwrap();
    let done = world.remote().gc(AT_ONCE, &Quiet::default()).unwrap();
    assert_eq!((would.runs, would.records, would.blobs), (1, 2, 2));
    assert_eq!((done.runs, done.records, done.blobs), (1, 2, 2));
    assert_eq!(
        (done.packs, done.new_packs, done.missing),
        (2, 1, 0),
        "small packs become one"
    );
    let there = world.store("there");
    world.remote().pull(&there, &second, &Quiet::default()).unwrap();
    assert_eq!(
        there.closure(&second.keys, &second.blobs).unwrap().missing,
        vec![]
    );
    let again = world.remote().gc(AT_ONCE, &Quiet::default()).unwrap();
    assert_eq!((again.runs, again.records, again.packs), (0, 0, 0));
    let checked = world
        .remote()
        .fsck(
            FsckOptions {
                read_data: ReadShare::ALL,
                repair: false,
            },
            &Quiet::default(),
        )
        .unwrap();
    assert_eq!(checked.faults, vec![]);
}

#[test]
fn a_collection_leaves_what_is_young() {
    let world = World::new();
    two_runs(&world);
    let options = GcOptions {
        grace: Duration::from_secs(3600),
        ..AT_ONCE
    };
    let done = world.remote().gc(options, &Quiet::default()).unwrap();
    assert_eq!((done.runs, done.records, done.blobs, done.packs), (0, 0, 0, 0));
}

#[test]
fn a_collection_and_a_push_exclude_each_other() {
    let world = World::new();
    let (here, run) = two_runs(&world);
    let lease = |name: &str| {
        let path = world.folder().join("leases").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, "another marf").unwrap();
        path
    };
    let exclusive = lease("exclusive");
    let busy = |error: RemoteError| {
        assert!(
            matches!(&error, RemoteError::Busy { holder, .. } if holder == "another marf"),
            "{error}"
        );
    };
    busy(world.remote().push(&here, &run, &Quiet::default()).unwrap_err());
    busy(world.remote().gc(AT_ONCE, &Quiet::default()).unwrap_err());
    let repair = FsckOptions {
        read_data: ReadShare::NONE,
        repair: true,
    };
    busy(world.remote().fsck(repair, &Quiet::default()).unwrap_err());
    assert!(exclusive.exists(), "the lease of another is left alone");
    std::fs::remove_file(&exclusive).unwrap();
    let shared = lease("shared-0123456789ab");
    busy(world.remote().gc(AT_ONCE, &Quiet::default()).unwrap_err());
    world.remote().push(&here, &run, &Quiet::default()).unwrap();
    // One that was not renewed for an hour is that of a program that died.
    let old = SystemTime::now() - Duration::from_secs(3600);
    std::fs::File::open(&shared).unwrap().set_modified(old).unwrap();
    world.remote().gc(AT_ONCE, &Quiet::default()).unwrap();
    assert_eq!(world.files("leases", ""), Vec::<PathBuf>::new());
}

#[test]
fn a_check_names_what_is_broken_and_a_repair_lets_the_next_push_send_it() {
    for (folder, ending) in [
        ("cas", ""),
        ("packs", ".pack"),
        ("packs", ".idx"),
        ("records", ""),
    ] {
        let world = World::new();
        let here = world.store("here");
        let run = run_in(&here);
        world.remote().push(&here, &run, &Quiet::default()).unwrap();
        let path = world.files(folder, ending)[0].clone();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[9] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let look = FsckOptions {
            read_data: ReadShare::ALL,
            repair: false,
        };
        let found = world.remote().fsck(look, &Quiet::default()).unwrap();
        let name = path
            .strip_prefix(world.folder())
            .unwrap()
            .to_string_lossy()
            .into_owned();
        assert!(
            found.faults.iter().any(|fault| fault.object == name),
            "{:?}",
            found.faults
        );
        assert!(
            found.faults.iter().any(|fault| fault.object.starts_with("runs/")),
            "the run is broken too"
        );
        if folder == "records" {
            let key = name.strip_prefix("records/").unwrap().replace('/', "");
            let said = format!("it names the result of key {key}, which is not there or not whole");
            let named = found.faults.iter().any(|fault| fault.what == said);
            assert!(named, "{said}: {:?}", found.faults);
        }
        assert!(!found.is_repaired);
        let repair = FsckOptions { repair: true, ..look };
        assert!(
            world
                .remote()
                .fsck(repair, &Quiet::default())
                .unwrap()
                .is_repaired
        );
        assert_eq!(
            world.remote().fsck(look, &Quiet::default()).unwrap().faults,
            vec![]
        );
        world.remote().push(&here, &run, &Quiet::default()).unwrap();
        let there = world.store("there");
        world.remote().pull(&there, &run, &Quiet::default()).unwrap();
        assert_eq!(there.closure(&run.keys, &run.blobs).unwrap().missing, vec![]);
    }
}
