//! Collection: removes what neither the caller's roots nor a running process needs.
//!
//! 1. All objects are listed. Only these can be removed, so objects stored later stay.
//! 2. Everything that the roots reach or the leases name is marked.
//! 3. Under the exclusive lock of collections the leases are read and marked again, and each object without a mark
//!    loses its file or its row. Meanwhile no process looks up an object to use.
//! 4. Packs with many dead bytes are rewritten. Other processes may work during this step.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, SystemTime},
};

use serde::Serialize;

use super::{
    Store, StoreError,
    census::Census,
    commit,
    files::Place,
    index::PackRewrite,
    lease,
    locks::{Lock, Share},
    mark::Marker,
    missing::MissingObject,
    objects::{Objects, PackCheck},
    pack::{self, Kind},
    staging,
};
use crate::Digest;

/// A pack is rewritten when more than one in this many bytes is dead.
const DEAD_SHARE: u64 = 4;
/// Longest wait for the index, which writers hold for milliseconds.
const PATIENCE: Duration = Duration::from_secs(60);
/// Bytes that are written before the packs they come from are removed.
const GROUP_BYTES: u64 = 256 << 20;

/// Keys and blobs that are kept with all they consist of and were made from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Roots {
    /// Keys of records.
    pub keys: Vec<Digest>,
    /// Blobs and sets.
    pub blobs: Vec<Digest>,
}

/// The plan of a collection.
#[derive(Debug, Clone, Default)]
pub struct GcPlan {
    /// Kept in any case.
    pub always: Roots,
    /// What runs need, newest first.
    pub runs: Vec<Roots>,
    /// Runs are kept, from the newest on, as long as everything that is kept fits in this many bytes. `None`
    /// keeps all.
    pub max_bytes: Option<u64>,
    /// Objects stored, or used by an ended process, within this time stay.
    pub grace: Duration,
    /// Nothing is removed. The report lists what would be removed.
    pub dry_run: bool,
}

/// Numbers of objects that a collection removed and kept.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct GcReport {
    /// Runs of the plan that were kept, from the newest on.
    pub runs_kept: usize,
    /// Bytes of all objects that were kept.
    pub kept_bytes: u64,
    /// Large blobs removed.
    pub loose_blobs: u64,
    /// Their bytes.
    pub loose_bytes: u64,
    /// Small blobs dropped from packs.
    pub packed_blobs: u64,
    /// Bytes of all objects dropped from packs.
    pub packed_bytes: u64,
    /// Records dropped.
    pub records: u64,
    /// Memos dropped.
    pub memos: u64,
    /// Packs removed or rewritten without their dead objects.
    pub packs: u64,
    /// Bytes that this freed.
    pub pack_bytes: u64,
    /// Folders of checkpoints of given-up work removed.
    pub scratch: u64,
    /// Objects that the roots need and the store lacks.
    #[serde(skip)]
    pub missing: Vec<MissingObject>,
}

/// Objects that lose their file or their row.
#[derive(Default)]
struct Garbage {
    loose: Vec<Digest>,
    packed: Vec<(Kind, Digest)>,
}

impl Store {
    /// Removes everything that neither the plan nor a process with this store open needs. May run at the same time as
    /// any number of processes.
    ///
    /// # Errors
    /// Returns an error if the store cannot be written, and [`StoreError::Locked`] if another program keeps the index
    /// locked: then no packed object was removed.
    pub fn gc(&self, plan: &GcPlan) -> Result<GcReport, StoreError> {
        self.commit()?;
        let objects = &self.objects;
        objects.staging()?;
        let _guard = objects.locks.take(Lock::Gc, Share::Exclusive, &objects.notices)?;
        objects.index.refresh(PATIENCE)?;
        let mut report = self.collect(plan)?;
        if !plan.dry_run {
            staging::sweep(&objects.files, &self.dir.join("tmp"));
            self.compact(&mut report)?;
        }
        Ok(report)
    }

    fn collect(&self, plan: &GcPlan) -> Result<GcReport, StoreError> {
        let objects = &self.objects;
        let census = Census::take(objects)?;
        let mut marker = Marker::new(objects, &census).with_memos()?;
        mark_roots(&mut marker, &plan.always)?;
        mark_leases(self, &mut marker, plan.grace)?;
        let mut report = GcReport::default();
        for run in &plan.runs {
            let before = plan.max_bytes.map(|most| (most, marker.clone()));
            mark_roots(&mut marker, run)?;
            if let Some((most, before)) = before
                && marker.bytes() > most
            {
                marker = before;
                break;
            }
            report.runs_kept += 1;
        }
        // From here to the last removal nobody looks anything up in order to use it.
        let collecting = objects
            .locks
            .take(Lock::Collect, Share::Exclusive, &objects.notices)?;
        let used = mark_leases(self, &mut marker, plan.grace)?;
        let dead = find_dead(objects, &marker, plan.grace, &mut report)?;
        let given_up = self.dead_checkpoints(plan, &used)?;
        report.scratch = given_up.len() as u64;
        if !plan.dry_run {
            remove(objects, &dead)?;
            for name in given_up {
                objects.files.remove_dir_all(&self.checkpoints().join(name))?;
            }
            remove_stale_leases(self, plan.grace)?;
        }
        drop(collecting);
        report.kept_bytes = marker.bytes();
        report.missing = marker.into_missing();
        report.missing.sort_unstable();
        Ok(report)
    }

    /// Returns the folders of checkpoints whose key nothing needs: neither the plan nor a process names it, or
    /// its record is there and no process uses it.
    fn dead_checkpoints(&self, plan: &GcPlan, used: &BTreeSet<Digest>) -> Result<Vec<String>, StoreError> {
        let planned: BTreeSet<&Digest> = std::iter::once(&plan.always)
            .chain(&plan.runs)
            .flat_map(|roots| &roots.keys)
            .collect();
        let mut dead = Vec::new();
        for name in self.objects.files.names(&self.checkpoints())? {
            let Ok(key) = name.parse::<Digest>() else {
                continue;
            };
            let is_young = is_young(&self.objects, &self.checkpoints().join(&name), plan.grace);
            let is_done = || Ok::<_, StoreError>(commit::record_of(&self.objects, &key)?.is_some());
            if !used.contains(&key) && !is_young && (!planned.contains(&key) || is_done()?) {
                dead.push(name);
            }
        }
        Ok(dead)
    }

    /// Removes packs without living objects, and rewrites packs with many dead bytes.
    fn compact(&self, report: &mut GcReport) -> Result<(), StoreError> {
        let objects = &self.objects;
        let _guard = objects
            .locks
            .take(Lock::Rewrite, Share::Exclusive, &objects.notices)?;
        let (empty, rest): (Vec<_>, Vec<_>) = live_by_pack(objects)?
            .into_iter()
            .partition(|(_, live)| live.objects.is_empty());
        // The packs that need no room go first: the disk may be full.
        let empty = empty.into_iter().map(|(from, _)| PackRewrite {
            from,
            into: String::new(),
            entries: Vec::new(),
        });
        replace(objects, &empty.collect::<Vec<_>>(), report)?;
        let (mut group, mut bytes) = (Vec::new(), 0);
        for (file, live) in rest {
            if objects.notices.is_interrupted() {
                break;
            }
            group.extend(rewrite(objects, &file, &live)?);
            bytes += live.bytes;
            if bytes >= GROUP_BYTES {
                replace(objects, &std::mem::take(&mut group), report)?;
                bytes = 0;
            }
        }
        replace(objects, &group, report)
    }
}

fn mark_roots(marker: &mut Marker<'_>, roots: &Roots) -> Result<(), StoreError> {
    roots.keys.iter().try_for_each(|key| marker.key(key))?;
    roots.blobs.iter().try_for_each(|blob| marker.root_blob(blob))
}

/// Marks everything that leases protect, and returns the keys that living processes use.
fn mark_leases(
    store: &Store,
    marker: &mut Marker<'_>,
    grace: Duration,
) -> Result<BTreeSet<Digest>, StoreError> {
    let files = &store.objects.files;
    let mut used = BTreeSet::new();
    for lease in lease::list(&store.dir, files)? {
        if is_stale(&lease, grace) {
            continue;
        }
        for entry in lease::read(files, &lease.path)? {
            match entry {
                lease::Use::Key(key) => {
                    used.extend(lease.is_alive.then_some(key));
                    marker.used_key(&key)?;
                }
                lease::Use::Blob(blob) => marker.used_blob(&blob)?,
            }
        }
    }
    Ok(used)
}

fn is_stale(lease: &lease::LeaseFile, grace: Duration) -> bool {
    !lease.is_alive && lease.age.is_some_and(|age| age >= grace)
}

fn remove_stale_leases(store: &Store, grace: Duration) -> Result<(), StoreError> {
    for lease in lease::list(&store.dir, &store.objects.files)? {
        if is_stale(&lease, grace) {
            store.objects.files.remove_file(&lease.path)?;
        }
    }
    Ok(())
}

/// Returns whether a file is younger than the grace. A time in the future counts as young, because the clock was set
/// back. So does a time that cannot be read.
fn is_young(objects: &Objects, path: &std::path::Path, grace: Duration) -> bool {
    let modified = objects.files.meta(path).map(|meta| meta.modified);
    modified.is_none_or(|time| match SystemTime::now().duration_since(time) {
        Ok(age) => age < grace,
        Err(_) => grace > Duration::ZERO,
    })
}

fn find_dead(
    objects: &Objects,
    marker: &Marker<'_>,
    grace: Duration,
    report: &mut GcReport,
) -> Result<Garbage, StoreError> {
    let mut dead = Garbage::default();
    objects.for_each_loose(|digest, meta| {
        let is_dead = marker.is_marked(Kind::Blob, &digest) == Some(false);
        if is_dead && !is_young(objects, &objects.loose_path(&digest), grace) {
            report.loose_blobs += 1;
            report.loose_bytes += match meta.place {
                Place::Here => meta.bytes,
                Place::Outside => 0,
            };
            dead.loose.push(digest);
        }
    })?;
    let young: BTreeSet<i64> = objects
        .index
        .segments()?
        .into_iter()
        .filter(|(_, file, _)| is_young(objects, &objects.pack_path(file), grace))
        .map(|(segment, ..)| segment)
        .collect();
    objects.index.for_each(|row| {
        if marker.is_marked(row.kind, &row.id) != Some(false) || young.contains(&row.segment) {
            return;
        }
        match row.kind {
            Kind::Blob => report.packed_blobs += 1,
            Kind::Record => report.records += 1,
            Kind::Memo => report.memos += 1,
        }
        report.packed_bytes += u64::from(row.len);
        dead.packed.push((row.kind, row.id));
    })?;
    Ok(dead)
}

fn remove(objects: &Objects, dead: &Garbage) -> Result<(), StoreError> {
    // Rows first: a record must not outlive its outputs for longer than a crash makes it.
    if !dead.packed.is_empty() && !objects.index.remove(&dead.packed)? {
        return Err(StoreError::Locked {
            path: objects.root.join("index.sqlite"),
            waited_ms: 0,
        });
    }
    for digest in &dead.loose {
        objects.files.remove_file(&objects.loose_path(digest))?;
    }
    Ok(())
}

/// Living objects of a pack, sorted, and their bytes.
#[derive(Default)]
struct LiveEntries {
    objects: Vec<(Digest, Kind)>,
    bytes: u64,
}

/// Returns the living objects of each registered pack with enough dead bytes.
fn live_by_pack(objects: &Objects) -> Result<BTreeMap<String, LiveEntries>, StoreError> {
    let files: BTreeMap<i64, String> = objects
        .index
        .segments()?
        .into_iter()
        .map(|(segment, file, _)| (segment, file))
        .collect();
    let mut packs: BTreeMap<String, LiveEntries> = BTreeMap::new();
    for file in files.values() {
        packs.entry(file.clone()).or_default();
    }
    objects.index.for_each(|row| {
        if let Some(live) = files.get(&row.segment).and_then(|file| packs.get_mut(file)) {
            live.bytes += u64::from(row.len) + pack::OVERHEAD;
        }
    })?;
    packs.retain(|file, live| {
        let bytes = objects
            .files
            .meta(&objects.pack_path(file))
            .map_or(0, |meta| meta.bytes);
        bytes.saturating_sub(live.bytes) > bytes / DEAD_SHARE
    });
    objects.index.for_each(|row| {
        if let Some(live) = files.get(&row.segment).and_then(|file| packs.get_mut(file)) {
            live.objects.push((row.id, row.kind));
        }
    })?;
    Ok(packs)
}

/// Writes the living objects of a pack to a new one. Returns `None` if the pack is damaged: the damage is handled when
/// the object is read, or by a check.
fn rewrite(objects: &Objects, file: &str, live: &LiveEntries) -> Result<Option<PackRewrite>, StoreError> {
    let (contents, checked) = objects.check_pack(file)?;
    let (Some(contents), PackCheck::Whole) = (contents, checked) else {
        return Ok(None);
    };
    let lives = |entry: &&pack::Entry| live.objects.binary_search(&(entry.id, entry.kind)).is_ok();
    let written = objects.rewrite_entries(file, contents.entries.iter().filter(lives))?;
    Ok(written.map(|(into, entries)| PackRewrite {
        from: file.to_owned(),
        into,
        entries,
    }))
}

/// Registers new packs in the index and removes the packs they replace. If the index does not take them,
/// removes the new packs.
fn replace(objects: &Objects, packs: &[PackRewrite], report: &mut GcReport) -> Result<(), StoreError> {
    if packs.is_empty() {
        return Ok(());
    }
    let is_known = objects.index.compact(packs)?;
    let bytes = |file: &str| {
        objects
            .files
            .meta(&objects.pack_path(file))
            .map_or(0, |meta| meta.bytes)
    };
    for pack in packs {
        if !is_known {
            if !pack.into.is_empty() {
                objects.files.remove_file(&objects.pack_path(&pack.into))?;
            }
            continue;
        }
        report.packs += 1;
        let after = if pack.into.is_empty() {
            0
        } else {
            bytes(&pack.into)
        };
        report.pack_bytes += bytes(&pack.from).saturating_sub(after);
        objects.files.remove_file(&objects.pack_path(&pack.from))?;
    }
    Ok(())
}
