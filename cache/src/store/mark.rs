//! Reachability: marks on the objects of a store, made by following the names in each object.

use std::collections::HashSet;

use super::{
    census::{Census, PREFIX, prefix},
    commit,
    error::StoreError,
    missing::MissingObject,
    objects::Objects,
    pack::Kind,
    read_digest_list,
    record::Record,
};
use crate::{
    Action, Digest, FINGERPRINT, LISTING,
    manifest::{Leaf, LeafRef, Root},
};

/// How a set is reached: what its leaves are, and whether they must be in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Walk {
    /// Leaves are blobs that an output consists of.
    Output,
    /// Leaves are blobs, or digests of what need not be stored: fingerprints of a listing, what a process has looked at.
    Input,
    /// Leaves are keys of parts.
    Parts,
}

#[derive(Clone)]
enum Task {
    Key {
        key: Digest,
        owner: Digest,
        role: &'static str,
    },
    Set {
        root: Digest,
        owner: Digest,
        walk: Walk,
    },
}

/// A memo with its maker. `memo` and `blob` are numbers of the census.
#[derive(Clone)]
struct MemoRow {
    maker: [u8; PREFIX],
    memo: u32,
    blob: u32,
}

/// Marks on a census.
#[derive(Clone)]
pub(super) struct Marker<'a> {
    objects: &'a Objects,
    census: &'a Census,
    marks: Vec<u64>,
    /// Marked objects that came after the census.
    extra: HashSet<(Kind, Digest)>,
    walked: HashSet<(Digest, Walk)>,
    memos: Vec<MemoRow>,
    tasks: Vec<Task>,
    missing: Vec<MissingObject>,
    listed: HashSet<(Kind, Digest)>,
    bytes: u64,
}

impl<'a> Marker<'a> {
    /// Returns a census without marks.
    pub(super) fn new(objects: &'a Objects, census: &'a Census) -> Self {
        Self {
            objects,
            census,
            marks: vec![0; census.len().div_ceil(64)],
            extra: HashSet::new(),
            walked: HashSet::new(),
            memos: Vec::new(),
            tasks: Vec::new(),
            missing: Vec::new(),
            listed: HashSet::new(),
            bytes: 0,
        }
    }

    /// Reads all memos, so that those of a record are marked with it.
    pub(super) fn with_memos(mut self) -> Result<Self, StoreError> {
        for key in self.objects.index.ids(Kind::Memo)? {
            let Some(memo) = commit::memo_of(self.objects, &key)? else {
                continue;
            };
            let found = (
                self.census.find(Kind::Memo, &key),
                self.census.find(Kind::Blob, &memo.blob),
            );
            // A memo whose blob was lost is of no use.
            let (Some(number), Some(blob)) = found else {
                continue;
            };
            self.memos.push(MemoRow {
                maker: prefix(&memo.maker),
                memo: number as u32,
                blob: blob as u32,
            });
        }
        self.memos.sort_unstable_by_key(|row| row.maker);
        Ok(self)
    }

    /// Returns the bytes of all marked objects of the census.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns the objects that are named but not in the store.
    pub(super) fn into_missing(self) -> Vec<MissingObject> {
        self.missing
    }

    /// Returns whether an object is marked, or `None` if it came after the census.
    pub(super) fn is_marked(&self, kind: Kind, id: &Digest) -> Option<bool> {
        self.census.find(kind, id).map(|number| self.has_mark(number))
    }

    /// Returns the marked objects that came after the census.
    pub(super) fn extra(&self) -> impl Iterator<Item = (Kind, Digest)> {
        self.extra.iter().copied()
    }

    fn has_mark(&self, number: usize) -> bool {
        let word = self.marks.get(number / 64).copied().unwrap_or(0);
        word >> (number % 64) & 1 == 1
    }

    /// Sets the mark of an object of the census. Returns whether it had no mark.
    fn set_mark(&mut self, number: usize) -> bool {
        if self.has_mark(number) {
            return false;
        }
        if let Some(word) = self.marks.get_mut(number / 64) {
            *word |= 1 << (number % 64);
        }
        self.bytes += self.census.bytes(number);
        true
    }

    /// Marks an object. Returns whether it is new, or `None` if it is not in the store.
    fn visit(&mut self, kind: Kind, id: &Digest) -> Result<Option<bool>, StoreError> {
        if let Some(number) = self.census.find(kind, id) {
            return Ok(Some(self.set_mark(number)));
        }
        if self.extra.contains(&(kind, *id)) {
            return Ok(Some(false));
        }
        let is_there = match kind {
            Kind::Blob => self.objects.contains(id),
            _ => self.objects.index.locate(kind, id)?.is_some(),
        };
        if !is_there {
            return Ok(None);
        }
        self.extra.insert((kind, *id));
        Ok(Some(true))
    }

    /// Marks a blob, and lists it where it is missing. Returns whether it is there.
    fn blob(&mut self, digest: &Digest, role: &'static str, owner: &Digest) -> Result<bool, StoreError> {
        let is_there = self.visit(Kind::Blob, digest)?.is_some();
        if !is_there {
            self.miss(Kind::Blob, digest, role, owner);
        }
        Ok(is_there)
    }

    /// Notes that what a set or leaf names is followed. Returns whether it was not before.
    fn walk(&mut self, digest: &Digest, walk: Walk) -> bool {
        self.walked.insert((*digest, walk))
    }

    /// Lists an object that is missing, once, as what it was first found to be named.
    fn miss(&mut self, kind: Kind, digest: &Digest, role: &'static str, owner: &Digest) {
        if self.listed.insert((kind, *digest)) {
            self.missing.push(MissingObject {
                digest: *digest,
                role,
                named_by: *owner,
            });
        }
    }

    /// Reads a blob. A damaged or vanished one is listed as missing.
    fn read(
        &mut self,
        digest: &Digest,
        role: &'static str,
        owner: &Digest,
    ) -> Result<Option<std::sync::Arc<[u8]>>, StoreError> {
        match self.objects.get(digest) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.lost().is_some() => {
                self.miss(Kind::Blob, digest, role, owner);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Marks everything reachable from a key, and lists a missing record.
    pub(super) fn key(&mut self, key: &Digest) -> Result<(), StoreError> {
        self.tasks.push(Task::Key {
            key: *key,
            owner: *key,
            role: "record",
        });
        self.run()
    }

    /// Marks everything reachable from a key that a process has looked up: a record, a memo, or neither yet.
    pub(super) fn used_key(&mut self, key: &Digest) -> Result<(), StoreError> {
        if self.visit(Kind::Memo, key)?.is_some()
            && let Some(memo) = commit::memo_of(self.objects, key)?
        {
            self.visit(Kind::Blob, &memo.blob)?;
        }
        self.visit(Kind::Blob, key)?;
        match commit::record_of(self.objects, key)? {
            Some(_) => self.key(key),
            None => Ok(()),
        }
    }

    /// Marks a blob and, if it is a set, all it consists of.
    pub(super) fn root_blob(&mut self, digest: &Digest) -> Result<(), StoreError> {
        self.blob(digest, "document or set", digest)?;
        self.tasks.push(Task::Set {
            root: *digest,
            owner: *digest,
            walk: Walk::Output,
        });
        self.run()
    }

    /// Marks a blob that a process uses and, if it is a set, what of it is stored.
    pub(super) fn used_blob(&mut self, digest: &Digest) -> Result<(), StoreError> {
        if self.visit(Kind::Blob, digest)?.is_none() {
            return Ok(());
        }
        self.tasks.push(Task::Set {
            root: *digest,
            owner: *digest,
            walk: Walk::Input,
        });
        self.run()
    }

    fn run(&mut self) -> Result<(), StoreError> {
        while let Some(task) = self.tasks.pop() {
            match task {
                Task::Key { key, owner, role } => self.follow_key(&key, &owner, role)?,
                Task::Set { root, owner, walk } => self.follow_set(&root, &owner, walk)?,
            }
        }
        Ok(())
    }

    fn follow_key(&mut self, key: &Digest, owner: &Digest, role: &'static str) -> Result<(), StoreError> {
        let visited = self.visit(Kind::Record, key)?;
        if visited == Some(false) {
            return Ok(());
        }
        let record = match visited {
            Some(_) => commit::record_of(self.objects, key)?,
            None => None,
        };
        let Some(record) = record else {
            self.miss(Kind::Record, key, role, owner);
            return Ok(());
        };
        self.mark_memos(key);
        self.follow_action(key)?;
        self.follow_record(&record)
    }

    fn mark_memos(&mut self, maker: &Digest) {
        let maker = prefix(maker);
        let first = self.memos.partition_point(|row| row.maker < maker);
        let rows = self.memos.get(first..).unwrap_or_default().iter();
        let numbers: Vec<u32> = rows
            .take_while(|row| row.maker == maker)
            .flat_map(|row| [row.memo, row.blob])
            .collect();
        for number in numbers {
            self.set_mark(number as usize);
        }
    }

    fn follow_action(&mut self, key: &Digest) -> Result<(), StoreError> {
        // A process may use the action as a blob: a mark on it does not show that its inputs are marked.
        self.blob(key, "action", key)?;
        let bytes = self.read(key, "action", key)?;
        let action = bytes.and_then(|bytes| Action::decode(&bytes).ok());
        for (name, input) in action.iter().flat_map(|action| &action.inputs) {
            let is_missing = self.visit(Kind::Blob, input)?.is_none();
            // A chain of steps begins with the digest of nothing, which nobody stores.
            let is_outside = name == FINGERPRINT || *input == Digest::from_content(&[]);
            if is_missing && !is_outside {
                self.miss(Kind::Blob, input, "input", key);
            }
            let walk = if name == LISTING {
                Walk::Input
            } else {
                Walk::Output
            };
            self.tasks.push(Task::Set {
                root: *input,
                owner: *key,
                walk,
            });
        }
        Ok(())
    }

    fn follow_record(&mut self, record: &Record) -> Result<(), StoreError> {
        let key = &record.key;
        for output in record.outputs.values() {
            self.blob(&output.digest, "output", key)?;
            self.tasks.push(Task::Set {
                root: output.digest,
                owner: *key,
                walk: Walk::Output,
            });
        }
        if let Some(list) = record.needs {
            self.blob(&list, "list of needs", key)?;
            let bytes = self.read(&list, "list of needs", key)?;
            let needs = bytes.and_then(|bytes| read_digest_list(&bytes));
            for digest in needs.unwrap_or_default() {
                self.blob(&digest, "stored beside the outputs", key)?;
            }
        }
        if let Some(parts) = record.parts {
            self.blob(&parts, "list of parts", key)?;
            self.tasks.push(Task::Set {
                root: parts,
                owner: *key,
                walk: Walk::Parts,
            });
        }
        self.tasks.extend(record.children.values().map(|child| Task::Key {
            key: *child,
            owner: *key,
            role: "record of a child",
        }));
        Ok(())
    }

    /// Marks everything that a set consists of. Does nothing for a blob that is not a set.
    fn follow_set(&mut self, root: &Digest, owner: &Digest, walk: Walk) -> Result<(), StoreError> {
        if !self.objects.is_set(root)? || !self.walk(root, walk) {
            return Ok(());
        }
        let Some(bytes) = self.read(root, "document or set", owner)? else {
            return Ok(());
        };
        // Bytes that begin as a set but are not a set name nothing.
        for block in Root::blocks(&bytes).unwrap_or_default() {
            self.blob(&block.digest, "block of a set", root)?;
            let Some(bytes) = self.read(&block.digest, "block of a set", root)? else {
                continue;
            };
            for leaf in Root::decode_leaves(&bytes).unwrap_or_default() {
                self.follow_leaf(&leaf, root, owner, walk)?;
            }
        }
        Ok(())
    }

    fn follow_leaf(
        &mut self,
        leaf: &LeafRef,
        root: &Digest,
        owner: &Digest,
        walk: Walk,
    ) -> Result<(), StoreError> {
        let digest = &leaf.leaf;
        let is_there = match walk {
            Walk::Parts => {
                self.tasks.push(Task::Key {
                    key: *digest,
                    owner: *owner,
                    role: "record of a part",
                });
                return Ok(());
            }
            Walk::Output => self.blob(digest, "sol of a set", root)?,
            Walk::Input => self.visit(Kind::Blob, digest)?.is_some(),
        };
        // As with an action, a mark on a leaf does not show that its rows are marked.
        if !is_there || !self.objects.is_leaf(digest)? || !self.walk(digest, walk) {
            return Ok(());
        }
        let bytes = self.read(digest, "sol of a set", root)?;
        let rows = bytes.and_then(|bytes| Leaf::decode(&bytes).ok());
        for row in rows.iter().flat_map(|leaf| &leaf.rows) {
            for blob in row.blobs.values() {
                self.blob(blob, "product", digest)?;
            }
        }
        Ok(())
    }
}
