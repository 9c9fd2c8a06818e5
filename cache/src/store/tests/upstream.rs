//! Blobs that a store lacks and gets from elsewhere.

use std::{collections::BTreeMap, sync::Arc};

use parking_lot::Mutex;

use crate::{Digest, Store, StoreError, Upstream};

/// Blobs by digest, whatever their bytes are, and how often each was asked for.
#[derive(Default)]
struct Table {
    blobs: BTreeMap<Digest, Vec<u8>>,
    asked: Mutex<Vec<Digest>>,
}

impl Upstream for Table {
    fn blob(&self, digest: &Digest) -> Result<Option<Vec<u8>>, String> {
        self.asked.lock().push(*digest);
        match self.blobs.get(digest) {
            Some(bytes) if bytes.is_empty() => Err("the line is dead".to_owned()),
            found => Ok(found.cloned()),
        }
    }
}

#[test]
fn a_blob_that_is_lacking_is_asked_for_once_and_believed_by_its_digest() {
    let dir = tempfile::tempdir().unwrap();
    let (here, there, wrong, dead) = (
        Digest::from_content(b"here"),
        Digest::from_content(b"there"),
        Digest::from_content(b"wrong"),
        Digest::from_content(b"dead"),
    );
    let table = Arc::new(Table {
        blobs: BTreeMap::from([
            (there, b"there".to_vec()),
            (wrong, b"another".to_vec()),
            (dead, Vec::new()),
        ]),
        ..Table::default()
    });
    let upstream: Arc<Table> = Arc::clone(&table);
    let store = Store::open(dir.path()).unwrap().with_upstream(upstream);
    store.put(b"here").unwrap();
    assert_eq!(&*store.get(&here).unwrap(), b"here");
    assert_eq!(&*store.get(&there).unwrap(), b"there");
    assert_eq!(&*store.get(&there).unwrap(), b"there");
    assert!(store.contains(&there));
    assert_eq!(*table.asked.lock(), [there]);
    let error = store.get(&wrong).unwrap_err();
    assert!(
        matches!(&error, StoreError::Upstream { message, .. } if message == "7 bytes of another digest came")
    );
    assert!(!store.contains(&wrong));
    assert_eq!(error.lost(), None, "no producer can help");
    assert!(
        store
            .get(&dead)
            .unwrap_err()
            .to_string()
            .ends_with("the line is dead")
    );
    let absent = Digest::from_content(b"absent");
    assert!(matches!(store.get(&absent), Err(StoreError::Missing { digest }) if digest == absent));
    assert_eq!(store.size_of(&Digest::from_content(b"there")), Some(5));
}

#[test]
fn what_passes_through_has_a_length_before_it_was_read() {
    let dir = tempfile::tempdir().unwrap();
    let there = Digest::from_content(b"there");
    let table = Table {
        blobs: BTreeMap::from([(there, b"there".to_vec())]),
        ..Table::default()
    };
    let store = Store::open(dir.path()).unwrap().with_upstream(Arc::new(table));
    assert!(!store.contains(&there));
    assert_eq!(store.size_of(&there), Some(5));
    assert_eq!(store.size_of(&Digest::from_content(b"absent")), None);
}
