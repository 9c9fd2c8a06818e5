//! Commits: a write batch becomes durable, in the order loose files, pack, rows of the index.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use super::{
    error::StoreError,
    lease::Use,
    objects::Objects,
    pack::{self, Kind},
    record::{Conflict, Record},
    write_batch::{LargeBlob, Memo, WriteBatch},
};
use crate::Digest;

/// What of a batch is written: what the store does not have.
#[derive(Default)]
struct Selection {
    records: BTreeMap<Digest, (u32, Record)>,
    memos: BTreeMap<Digest, (u32, Memo)>,
    conflicts: Vec<Conflict>,
}

/// Writes a batch and returns the conflicts found. On an error the whole batch may be written again.
pub(super) fn write(objects: &Objects, batch: &WriteBatch) -> Result<Vec<Conflict>, StoreError> {
    // A store that cannot be written says so before anything else fails.
    objects.staging()?;
    let uses: Vec<Use> = batch
        .blobs()
        .chain(batch.memos.values().map(|memo| memo.blob))
        .map(Use::Blob)
        .chain(
            batch
                .records
                .keys()
                .chain(batch.memos.keys())
                .copied()
                .map(Use::Key),
        )
        .collect();
    let select = || Selection::new(objects, batch);
    let selection = objects
        .lease
        .protect(&uses, &objects.locks, &objects.notices, select)?;
    write_large(objects, batch)?;
    let mut conflicts = selection.conflicts.clone();
    conflicts.extend(write_pack(objects, batch, &selection)?);
    Ok(conflicts)
}

impl Selection {
    fn new(objects: &Objects, batch: &WriteBatch) -> Result<Self, StoreError> {
        let mut selection = Self::default();
        for record in batch.records.values() {
            selection.add_record(objects, batch, record)?;
        }
        for (key, memo) in &batch.memos {
            let first = memo_of(objects, key)?;
            let generation = objects.index.locate(Kind::Memo, key)?;
            if first != Some(*memo) {
                let next = generation.map_or(0, |location| location.generation + 1);
                selection.memos.insert(*key, (next, *memo));
            }
        }
        Ok(selection)
    }

    fn add_record(
        &mut self,
        objects: &Objects,
        batch: &WriteBatch,
        record: &Record,
    ) -> Result<(), StoreError> {
        let first = record_of(objects, &record.key)?;
        let Some(first) = first else {
            self.records.insert(record.key, (0, record.clone()));
            return Ok(());
        };
        let differs = first.outputs != record.outputs;
        let is_stored = |digest: Digest| batch.size_of(&digest).is_some() || objects.contains(&digest);
        if first.objects().all(is_stored) {
            if differs {
                self.conflicts.push(conflict(first, record.clone(), false));
            }
            return Ok(());
        }
        let generation = objects.index.locate(Kind::Record, &record.key)?;
        let next = generation.map_or(0, |location| location.generation + 1);
        self.records.insert(record.key, (next, record.clone()));
        if differs {
            self.conflicts.push(conflict(record.clone(), first, true));
        }
        Ok(())
    }
}

fn conflict(kept: Record, refused: Record, replaced: bool) -> Conflict {
    Conflict {
        key: kept.key,
        stage: kept.stage,
        kept: kept.outputs,
        refused: refused.outputs,
        replaced,
    }
}

/// Returns the record of a key, or `None` if it is missing or damaged. A damaged record is then in
/// quarantine.
pub(super) fn record_of(objects: &Objects, key: &Digest) -> Result<Option<Record>, StoreError> {
    let content = content_of(objects, Kind::Record, key)?;
    Ok(content
        .and_then(|json| Record::decode(&json))
        .filter(|record| record.key == *key))
}

/// Returns the memo of a key, as [`record_of`].
pub(super) fn memo_of(objects: &Objects, key: &Digest) -> Result<Option<Memo>, StoreError> {
    let content = content_of(objects, Kind::Memo, key)?;
    Ok(content.and_then(|bytes| Memo::decode(&bytes)))
}

fn content_of(objects: &Objects, kind: Kind, key: &Digest) -> Result<Option<Vec<u8>>, StoreError> {
    match objects.payload(kind, key) {
        Err(StoreError::Damaged { path, .. }) => {
            objects.notices.warn(format!(
                "the {} of key {} was damaged and is in quarantine in `{}`",
                kind.name(),
                key.short(),
                path.display()
            ));
            Ok(None)
        }
        other => other,
    }
}

/// Syncs the large blobs of a batch, gives them their names, and syncs the folders.
fn write_large(objects: &Objects, batch: &WriteBatch) -> Result<(), StoreError> {
    let mut unsynced = Vec::new();
    for large in batch.large.values() {
        // An absent one was published by an attempt that failed later.
        if objects.files.exists(&large.path)? {
            unsynced.push(large.path.clone());
        }
    }
    objects.files.sync_files(&unsynced)?;
    let mut folders = BTreeSet::new();
    for (digest, large) in &batch.large {
        publish_large(objects, digest, large, &mut folders)?;
    }
    let folders: Vec<PathBuf> = folders.into_iter().collect();
    objects.files.sync_dirs(&folders)
}

fn publish_large(
    objects: &Objects,
    digest: &Digest,
    large: &LargeBlob,
    folders: &mut BTreeSet<PathBuf>,
) -> Result<(), StoreError> {
    let to = objects.loose_path(digest);
    let Some(folder) = to.parent() else { return Ok(()) };
    if !objects.files.exists(folder)? {
        objects.files.create_dir(folder)?;
    }
    // Also where an attempt that failed, or another process, has created it and not synced it yet.
    folders.insert(folder.to_owned());
    folders.insert(objects.root.join("cas"));
    if objects.files.exists(&to)? {
        return objects.files.remove_file(&large.path);
    }
    objects.files.publish(&large.path, &to)?;
    Ok(())
}

/// Writes one pack with the small blobs, the records and the memos, and registers it. Returns the conflicts with records
/// that another process committed at the same time.
fn write_pack(
    objects: &Objects,
    batch: &WriteBatch,
    selection: &Selection,
) -> Result<Vec<Conflict>, StoreError> {
    if batch.small.is_empty() && selection.records.is_empty() && selection.memos.is_empty() {
        return Ok(Vec::new());
    }
    let staging = objects.staging()?;
    let name = format!("{}.pack", staging.next_name());
    let temporary = staging.path(&name);
    let mut writer = pack::Writer::new(&objects.files, &temporary);
    for (digest, blob) in &batch.small {
        writer.add(Kind::Blob, digest, blob)?;
    }
    for (key, (generation, record)) in &selection.records {
        let payload = pack::seal(Kind::Record, key, *generation, &record.encode());
        writer.add(Kind::Record, key, &payload)?;
    }
    for (key, (generation, memo)) in &selection.memos {
        let payload = pack::seal(Kind::Memo, key, *generation, &memo.encode());
        writer.add(Kind::Memo, key, &payload)?;
    }
    let entries = writer.finish()?;
    objects.publish_pack(&temporary, &name)?;
    // From here on the batch is stored: the index can be made from the packs at any time.
    if let Err(error) = objects.index.add(&name, &entries) {
        objects
            .notices
            .warn(format!("results are stored, but not yet in the index: {error}"));
        return Ok(Vec::new());
    }
    Ok(lost_races(objects, &name, selection))
}

fn lost_races(objects: &Objects, name: &str, selection: &Selection) -> Vec<Conflict> {
    let mut conflicts = Vec::new();
    for (key, (_, record)) in &selection.records {
        let Ok(Some(location)) = objects.index.locate_known(Kind::Record, key) else {
            continue;
        };
        if location.file == name {
            continue;
        }
        if let Some(first) = record_of(objects, key).ok().flatten()
            && first.outputs != record.outputs
        {
            conflicts.push(conflict(first, record.clone(), false));
        }
    }
    conflicts
}
