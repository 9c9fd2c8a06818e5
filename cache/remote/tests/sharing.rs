//! A shared store used during a run: fetched results, sent results and warnings.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod common;

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use common::{Quiet, World, result, run_in};
use marf_cache::{Digest, Store, Upstream};
use marf_keys::{PublicKey, SigningKey};
use marf_remote::{GcOptions, Patience, Reader, Remote, RemoteError, Sharing, Trust};

/// A run on a local store, with its warnings.
struct Machine {
    store: Store,
    sharing: Sharing,
    told: Arc<Mutex<Vec<String>>>,
}

impl Machine {
    fn new(world: &World, name: &str) -> Self {
        Self::that_verifies(world, name, 0.0)
    }

    /// As [`Machine::new`], with a share of results of others that it makes again.
    fn that_verifies(world: &World, name: &str, share: f64) -> Self {
        Self::with(world, name, Trust::default(), share)
    }

    fn with(world: &World, name: &str, trust: Trust, share: f64) -> Self {
        let store = world.store(name);
        let told: Arc<Mutex<Vec<String>>> = Arc::default();
        let sink = Arc::clone(&told);
        let warn = move |message| sink.lock().unwrap().push(message);
        let remote = Remote::open(&world.url(), Patience::Impatient, trust).unwrap();
        let sharing = Sharing::start(remote, share, store.dir(), warn, || false).unwrap();
        Self { store, sharing, told }
    }

    fn told(&self) -> Vec<String> {
        self.told.lock().unwrap().clone()
    }

    /// Waits until everything that was offered is sent.
    fn finish(&self) {
        self.sharing.finish(None, Duration::from_secs(60));
    }
}

#[test]
fn what_one_run_offers_another_fetches() {
    let world = World::new();
    let (here, there) = (Machine::new(&world, "here"), Machine::new(&world, "there"));
    let run = run_in(&here.store);
    run.keys.iter().for_each(|key| here.sharing.offer(key));
    here.finish();
    there
        .sharing
        .fetch(&[run.keys[0], Digest::from_content(b"never made")]);
    let closure = |store: &Store| store.closure(&run.keys[..1], &[]).unwrap();
    assert_eq!(closure(&here.store), closure(&there.store));
    assert_eq!(
        there.store.record(&run.keys[1]).unwrap(),
        None,
        "nobody asked for it"
    );
    assert_eq!(
        there.store.record(&Digest::from_content(b"never made")).unwrap(),
        None
    );
    there.finish();
    assert_eq!((here.told(), there.told()), (vec![], vec![]));
}

#[test]
fn nothing_is_found_where_no_shared_store_is_yet() {
    let world = World::new();
    let here = Machine::new(&world, "here");
    here.sharing.fetch(&[Digest::from_content(b"key")]);
    here.finish();
    assert_eq!(here.told(), Vec::<String>::new());
}

#[test]
fn a_conflict_is_told_with_both_digests() {
    let world = World::new();
    let (here, there) = (Machine::new(&world, "here"), Machine::new(&world, "there"));
    let key = result(&here.store, "same key", b"one result", &[], &[]);
    result(&there.store, "same key", b"another result", &[], &[]);
    for machine in [&here, &there] {
        machine.store.commit().unwrap();
        machine.sharing.offer(&key);
        machine.finish();
    }
    assert_eq!(here.told(), Vec::<String>::new());
    let told = there.told();
    let digests =
        [b"one result".as_slice(), b"another result"].map(|bytes| Digest::from_content(bytes).to_string());
    assert!(
        told.len() == 1
            && told[0].contains(&format!(
                "stage `stage` has two results for key {key}: out {} is in the shared store and stays, out {} is not sent",
                digests[0], digests[1]
            )),
        "{told:?}"
    );
}

/// Two keys of tests: their 32 bytes are seven times and eight times the same.
const KEYS: [&str; 2] = [
    "MC4CAQAwBQYDK2VwBCIEIAcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcHBwcH",
    "MC4CAQAwBQYDK2VwBCIEIAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgI",
];

fn key(number: usize) -> SigningKey {
    let text = KEYS[number];
    SigningKey::from_pem(&format!(
        "-----BEGIN PRIVATE KEY-----\n{text}\n-----END PRIVATE KEY-----\n"
    ))
    .unwrap()
}

fn trust(signs: Option<usize>, believes: Option<usize>) -> Trust {
    let public = |number: usize| -> PublicKey { key(number).public() };
    Trust {
        key: signs.map(key),
        writers: believes.map(public).into_iter().collect(),
    }
}

/// A machine that names trusted writers neither fetches nor pulls results of strangers. A trusted writer signs the correct ones again,
/// and a wrong one stays a conflict.
#[test]
fn results_of_strangers_are_not_believed_where_writers_are_named() {
    let world = World::new();
    for (name, signs) in [("nobody", None), ("stranger", Some(1))] {
        let machine = Machine::with(&world, name, trust(signs, None), 0.0);
        let mut run = run_in(&machine.store);
        run.keys.push(result(
            &machine.store,
            &format!("wrong {name}"),
            b"wrong",
            &[],
            &[],
        ));
        machine.store.commit().unwrap();
        world
            .remote_of(trust(signs, None))
            .push(&machine.store, &run, &Quiet::default())
            .unwrap();
    }
    let friend = Machine::with(&world, "friend", trust(Some(0), Some(0)), 0.0);
    let run = run_in(&friend.store);
    let reader = Machine::with(&world, "reader", trust(None, Some(0)), 0.0);
    reader.sharing.fetch(&run.keys);
    assert_eq!(reader.store.record(&run.keys[0]).unwrap(), None);
    let told = reader.told();
    assert!(
        told.len() == 1
            && told[0].starts_with(&format!(
                "2 results of {} are signed by no key of `trust`, the first is ",
                world.url()
            )),
        "{told:?}"
    );
    let remote = world.remote_of(trust(None, Some(0)));
    let strange = remote.runs(None, &Quiet::default()).unwrap()[0].1;
    let refused = remote.run(&strange, &Quiet::default()).unwrap_err();
    assert!(
        matches!(refused, RemoteError::Untrusted { what: "run", .. }),
        "{refused}"
    );
    assert_eq!(
        refused.to_string(),
        format!(
            "1 run of {} is signed by no key of `trust`, the first is {strange}",
            world.url()
        )
    );
    let refused = remote
        .bring(&reader.store, &run.keys, &Quiet::default())
        .unwrap_err();
    assert!(
        matches!(refused, RemoteError::Untrusted { what: "result", .. }),
        "{refused}"
    );

    let mut keys = run.keys.clone();
    keys.push(result(&friend.store, "wrong nobody", b"right", &[], &[]));
    friend.store.commit().unwrap();
    let pushed = world
        .remote_of(trust(Some(0), Some(0)))
        .send(&friend.store, &keys, &[], &Quiet::default())
        .unwrap();
    assert_eq!(pushed.conflicts.len(), 1, "{:?}", pushed.conflicts);
    reader.sharing.fetch(&run.keys);
    assert!(reader.store.record(&run.keys[0]).unwrap().is_some());
    reader.finish();
    // Who names nobody believes all.
    Machine::new(&world, "open").sharing.fetch(&run.keys);
}

/// A valid blob that is not the result of its key passes by its digest. Computing the result again finds it.
#[test]
fn a_poisoned_result_is_found_by_who_makes_it_again() {
    let world = World::new();
    let poisoner = Machine::new(&world, "poisoner");
    let keys: Vec<Digest> = (0..40)
        .map(|index| result(&poisoner.store, &format!("key {index}"), b"poison", &[], &[]))
        .collect();
    poisoner.store.commit().unwrap();
    keys.iter().for_each(|key| poisoner.sharing.offer(key));
    poisoner.finish();
    let fetched = |share: f64| {
        let machine = Machine::that_verifies(&world, &format!("share {share}"), share);
        machine.sharing.fetch(&keys);
        let lacking: Vec<usize> = (0..keys.len())
            .filter(|index| machine.store.record(&keys[*index]).unwrap().is_none())
            .collect();
        for index in &lacking {
            result(&machine.store, &format!("key {index}"), b"truth", &[], &[]);
        }
        machine.store.commit().unwrap();
        keys.iter().for_each(|key| machine.sharing.offer(key));
        machine.finish();
        assert_eq!(machine.told().len(), lacking.len(), "share {share}");
        lacking.len()
    };
    assert_eq!(fetched(0.0), 0);
    assert_eq!(fetched(1.0), keys.len());
    // Of 40 keys a share of a half leaves out all or none once in 5e11 times.
    assert!((1..keys.len()).contains(&fetched(0.5)));
}

#[test]
fn a_shared_store_that_is_away_is_told_once() {
    let world = World::new();
    let here = Machine::new(&world, "here");
    let run = run_in(&here.store);
    std::fs::remove_dir(world.folder()).unwrap();
    std::fs::write(world.folder(), "a file").unwrap();
    here.sharing.fetch(&run.keys);
    here.sharing.fetch(&run.keys);
    run.keys.iter().for_each(|key| here.sharing.offer(key));
    here.sharing.finish(Some(run), Duration::from_secs(60));
    let told = here.told();
    assert!(
        told.len() == 1 && told[0].contains("goes on without the shared store"),
        "{told:?}"
    );
}

/// The run knows the packs from before the collection.
#[test]
fn a_run_finds_what_a_collection_has_moved_to_another_pack() {
    let world = World::new();
    let there = Machine::new(&world, "there");
    let here = world.store("here");
    let first = run_in(&here);
    world.remote().push(&here, &first, &Quiet::default()).unwrap();
    let mut second = first.clone();
    second.started_unix_s += 1;
    second.keys.push(result(&here, "new", b"n", &[], &[]));
    world.remote().push(&here, &second, &Quiet::default()).unwrap();
    there.sharing.fetch(&first.keys[..1]);
    let options = GcOptions {
        keep_last: 1,
        grace: Duration::ZERO,
        dry_run: false,
    };
    let collected = world.remote().gc(options, &Quiet::default()).unwrap();
    assert_eq!(collected.new_packs, 1);
    there.sharing.fetch(&second.keys);
    assert_eq!(there.store.closure(&second.keys, &[]).unwrap().missing, vec![]);
    assert_eq!(there.told(), Vec::<String>::new());
}

#[test]
fn a_damaged_result_is_told_and_the_run_makes_it() {
    let world = World::new();
    let there = Machine::new(&world, "there");
    let here = world.store("here");
    let run = run_in(&here);
    world.remote().push(&here, &run, &Quiet::default()).unwrap();
    for file in world.files("cas", "") {
        std::fs::write(file, "half").unwrap();
    }
    there.sharing.fetch(&run.keys[..1]);
    there.sharing.fetch(&run.keys[1..]);
    assert_eq!(there.store.record(&run.keys[0]).unwrap(), None);
    let told = there.told();
    assert!(
        told.len() == 2 && told.iter().all(|told| told.contains("is damaged")),
        "{told:?}"
    );
}

#[test]
fn a_reader_finds_blobs_one_by_one_also_those_that_have_come_or_moved_since() {
    let world = World::new();
    let here = world.store("here");
    let reader = Reader::new(Arc::new(world.remote()), Quiet::default());
    let first = run_in(&here);
    world.remote().push(&here, &first, &Quiet::default()).unwrap();
    let read = |bytes: &[u8]| reader.blob(&Digest::from_content(bytes)).unwrap();
    assert_eq!(read(b"need of map").as_deref(), Some(b"need of map".as_slice()));
    let large = "map".repeat(70_000).into_bytes();
    assert_eq!(read(&large), Some(large));
    assert_eq!(read(b"never stored"), None);
    let mut second = first;
    second.started_unix_s += 1;
    second.keys.push(result(&here, "new", b"n", &[], &[]));
    world.remote().push(&here, &second, &Quiet::default()).unwrap();
    assert_eq!(
        read(b"need of new").as_deref(),
        Some(b"need of new".as_slice()),
        "it has come"
    );
    let options = GcOptions {
        keep_last: 1,
        grace: Duration::ZERO,
        dry_run: false,
    };
    world.remote().gc(options, &Quiet::default()).unwrap();
    assert_eq!(
        read(b"need of map").as_deref(),
        Some(b"need of map".as_slice()),
        "it has moved"
    );
}
