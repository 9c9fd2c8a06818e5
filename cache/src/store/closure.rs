//! Everything that a result consists of and was made from.

use super::{Store, StoreError, census::Census, mark::Marker, missing::MissingObject, pack::Kind};
use crate::Digest;

/// All objects that some keys and blobs consist of and were made from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Closure {
    /// Keys whose records are in the store, sorted.
    pub keys: Vec<Digest>,
    /// Blobs, sorted, including the actions of the keys.
    pub blobs: Vec<Digest>,
    /// Bytes of all of them.
    pub bytes: u64,
    /// Objects that are named but not in the store, sorted by digest.
    pub missing: Vec<MissingObject>,
}

impl Store {
    /// Returns everything that keys and blobs consist of and were made from. For a key: its record, its action with
    /// all inputs, its outputs, needs, parts and children. For a set: its blocks, leaves and the blobs of its rows.
    ///
    /// Commits first. At 1,000,000 objects it takes less than 100 MB.
    ///
    /// # Errors
    /// Returns an error if the store cannot be read. A missing object is not an error.
    pub fn closure(&self, keys: &[Digest], blobs: &[Digest]) -> Result<Closure, StoreError> {
        self.commit()?;
        let objects = &self.objects;
        let census = Census::take(objects)?;
        let mut marker = Marker::new(objects, &census);
        keys.iter().try_for_each(|key| marker.key(key))?;
        blobs.iter().try_for_each(|blob| marker.root_blob(blob))?;
        let mut closure = Closure {
            bytes: marker.bytes(),
            ..Closure::default()
        };
        objects.index.for_each(|row| {
            if marker.is_marked(row.kind, &row.id) == Some(true) {
                closure.push(row.kind, row.id);
            }
        })?;
        objects.for_each_loose(|digest, _| {
            if marker.is_marked(Kind::Blob, &digest) == Some(true) {
                closure.push(Kind::Blob, digest);
            }
        })?;
        marker.extra().for_each(|(kind, id)| closure.push(kind, id));
        closure.missing = marker.into_missing();
        closure.missing.sort_unstable();
        for list in [&mut closure.keys, &mut closure.blobs] {
            list.sort_unstable();
            list.dedup();
        }
        Ok(closure)
    }
}

impl Closure {
    fn push(&mut self, kind: Kind, id: Digest) {
        match kind {
            Kind::Blob => self.blobs.push(id),
            Kind::Record => self.keys.push(id),
            Kind::Memo => {}
        }
    }
}
