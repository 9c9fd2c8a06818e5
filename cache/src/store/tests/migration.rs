//! A store of 0.1.0, made by that program.

use super::*;

fn fixture() -> tempfile::TempDir {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/store-0.1.0");
    let dir = tempfile::tempdir().unwrap();
    for path in files_below(&from) {
        let to = dir.path().join(".marf").join(path.strip_prefix(&from).unwrap());
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(&path, &to).unwrap();
    }
    dir
}

fn blobs() -> [(Vec<u8>, Digest); 4] {
    [
        b"three photos of sol 1".to_vec(),
        b"two photos of sol 1".to_vec(),
        b"features".to_vec(),
        vec![7; 66_000],
    ]
    .map(|bytes| (bytes.clone(), Digest::of(&bytes)))
}

#[test]
fn an_old_store_is_refused_with_the_command_that_migrates_it() {
    let dir = fixture();
    let Err(error) = Store::open(dir.path().join(".marf")) else {
        panic!("an old store was opened");
    };
    assert!(matches!(error, StoreError::Older { .. }), "{error}");
    assert!(error.hint().unwrap().contains("`marf cache migrate`"));
}

#[test]
fn a_migration_keeps_every_blob_and_run_and_tells_what_is_made_again() {
    let dir = fixture();
    let root = dir.path().join(".marf");
    let planned = Store::plan_migration(&root).unwrap();
    assert_eq!((planned.blobs, planned.bytes, planned.runs), (4, 66_048, 1));
    let nodes: Vec<_> = planned
        .nodes
        .iter()
        .map(|node| (node.name.as_str(), node.seconds))
        .collect();
    assert_eq!(nodes, [("extract", 1.5), ("blur", 0.25), ("train", 42.0)]);
    assert!(Store::open(&root).is_err(), "a plan changes nothing");
    assert_eq!(Store::migrate(&root).unwrap(), planned);
    let store = again(&dir);
    for (bytes, digest) in blobs() {
        assert_eq!(&*store.get(&digest).unwrap(), bytes.as_slice());
        assert_eq!(store.size_of(&digest), Some(bytes.len() as u64));
        assert_eq!(store.put(&bytes).unwrap(), digest);
    }
    store.commit().unwrap();
    assert_eq!(store.stat().unwrap().packs, 1, "an old blob was stored again");
    assert!(
        String::from_utf8(store.run(1).unwrap())
            .unwrap()
            .contains("marf run")
    );
    assert_eq!(store.put_run(b"{}").unwrap(), 2);
    assert!(root.join("bad/index.redb").exists());
    assert_eq!(Store::migrate(&root).unwrap(), Migration::default());
    let record = record("k", &store, b"made again");
    store.put_record(record.clone());
    store.commit().unwrap();
    assert_eq!(again(&dir).hit(&record.key).unwrap(), Some(record));
}

#[test]
fn a_migration_that_was_cut_off_at_any_call_can_be_repeated() {
    use super::{
        super::{files::Files, migrate::migrate_on},
        layer::{Faulty, Mishap},
    };
    for at in 0.. {
        let dir = fixture();
        let root = dir.path().join(".marf");
        let faulty = Faulty::new(at, Mishap::Crash, &dir.path().join("removed"));
        let cut = migrate_on(
            &Files::of(Arc::clone(&faulty) as Arc<dyn files::Operations>),
            &root,
        );
        faulty.lose_unsynced();
        Store::migrate(&root).unwrap();
        let store = again(&dir);
        for (bytes, digest) in blobs() {
            assert_eq!(&*store.get(&digest).unwrap(), bytes.as_slice(), "call {at}");
        }
        if cut.is_ok() && faulty.calls() <= at {
            break;
        }
    }
}

/// A collection may drop blobs of old packs, and writes what lives of them in the new form.
#[test]
fn a_collection_rewrites_an_old_pack() {
    let dir = fixture();
    Store::migrate(&dir.path().join(".marf")).unwrap();
    let store = again(&dir);
    let [(bytes, kept), ..] = blobs();
    let plan = GcPlan {
        always: Roots {
            keys: Vec::new(),
            blobs: vec![kept],
        },
        ..GcPlan::default()
    };
    let report = store.gc(&plan).unwrap();
    assert_eq!((report.packed_blobs, report.loose_blobs, report.packs), (2, 1, 1));
    assert_eq!(&*again(&dir).get(&kept).unwrap(), bytes.as_slice());
    assert!(
        packs(&store)
            .iter()
            .all(|path| path.extension().unwrap() == "pack")
    );
}
