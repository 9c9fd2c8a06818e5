//! A check of everything that is stored.

use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    path::PathBuf,
};

use serde::Serialize;

use super::{
    Store, StoreError,
    files::Access,
    format,
    locks::{Lock, Share},
    pack::{self, Contents, Entry, Kind, Window},
    read_share::ReadShare,
    record::Record,
    runs,
};
use crate::Digest;

/// How far a check goes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FsckOptions {
    /// The blobs whose bytes are read and compared with their digests.
    pub read_data: ReadShare,
    /// Quarantines damaged files and rebuilds a wrong index.
    pub repair: bool,
}

/// A damaged or missing object or file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// The file, below the folder of the store.
    pub file: PathBuf,
    /// The blob, or the key of the record or memo. `None` if the fault is not in one object.
    pub object: Option<Digest>,
    /// What is wrong.
    pub what: &'static str,
    /// The results that cannot be used because of it: stage and key of each.
    pub breaks: Vec<(String, Digest)>,
}

/// A document of a run that is not in the store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LostDocument {
    /// Number of the run.
    pub run: u64,
    /// Name of the document.
    pub name: String,
    /// Its digest.
    pub digest: Digest,
}

/// Report of a check.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct FsckReport {
    /// Blobs seen.
    pub blobs: u64,
    /// Records seen.
    pub records: u64,
    /// Memos seen.
    pub memos: u64,
    /// Run roots seen.
    pub runs: u64,
    /// Bytes that were read and compared with a digest.
    pub verified_bytes: u64,
    /// All faults.
    pub faults: Vec<Fault>,
    /// Documents of runs that are not in the store. They cannot be made again, so they are not faults.
    pub lost_documents: Vec<LostDocument>,
    /// Whether the faults were repaired.
    pub is_repaired: bool,
}

/// An entry of a pack in little room, for comparison with the index.
type Place = (Digest, Kind, u32, u64, u32);

struct Check<'a> {
    store: &'a Store,
    options: FsckOptions,
    report: FsckReport,
    /// Packs with a damaged table or entry.
    packs: BTreeMap<String, (Contents, Vec<Entry>)>,
    places: Vec<Place>,
    is_index_wrong: bool,
}

impl Store {
    /// Verifies everything there is: files, packs, index, records with what they name, run roots.
    ///
    /// # Errors
    /// Returns an error if the store cannot be read, or cannot be written for a repair. Faults are not
    /// errors. [`StoreError::Stopped`], between two objects and before a repair.
    pub fn fsck(&self, options: FsckOptions) -> Result<FsckReport, StoreError> {
        self.commit()?;
        let mut check = Check {
            store: self,
            options,
            report: FsckReport::default(),
            packs: BTreeMap::new(),
            places: Vec::new(),
            is_index_wrong: false,
        };
        check.format()?;
        check.loose()?;
        let files: Vec<String> = self.objects.index.listed()?.into_iter().collect();
        for (number, file) in files.iter().enumerate() {
            check.pack(number as u32, file)?;
        }
        check.index(&files)?;
        check.records()?;
        check.runs()?;
        if options.repair {
            check.go_on()?;
            check.repair()?;
        }
        Ok(check.report)
    }
}

impl Check<'_> {
    /// Returns an error if the caller wants to stop.
    fn go_on(&self) -> Result<(), StoreError> {
        if self.store.objects.notices.is_interrupted() {
            return Err(StoreError::Stopped);
        }
        Ok(())
    }

    fn fault(&mut self, file: impl Into<PathBuf>, object: Option<Digest>, what: &'static str) {
        self.report.faults.push(Fault {
            file: file.into(),
            object,
            what,
            breaks: Vec::new(),
        });
    }

    fn below(&self, path: &std::path::Path) -> PathBuf {
        path.strip_prefix(&self.store.dir).unwrap_or(path).to_owned()
    }

    fn format(&mut self) -> Result<(), StoreError> {
        let files = &self.store.objects.files;
        if format::find(files, &self.store.dir)? != format::StoreForm::Current {
            self.fault("format", None, "the file is damaged");
        }
        Ok(())
    }

    fn loose(&mut self) -> Result<(), StoreError> {
        let objects = &self.store.objects;
        let mut found = Vec::new();
        objects.for_each_loose(|digest, _| found.push(digest))?;
        for digest in found {
            self.go_on()?;
            self.report.blobs += 1;
            if !self.options.read_data.has(&digest) {
                continue;
            }
            let path = objects.loose_path(&digest);
            let bytes = objects.files.read(&path)?.unwrap_or_default();
            self.report.verified_bytes += bytes.len() as u64;
            if Digest::from_content(&bytes) != digest {
                self.fault(
                    self.below(&path),
                    Some(digest),
                    "the bytes do not have their digest",
                );
            }
        }
        Ok(())
    }

    /// Verifies the table, the records and the memos of a pack, and if asked for its blobs.
    fn pack(&mut self, number: u32, file: &str) -> Result<(), StoreError> {
        let objects = &self.store.objects;
        let path = objects.pack_path(file);
        let Some(contents) = pack::contents(&objects.files, &path)? else {
            return Ok(());
        };
        let name = self.below(&path);
        if !contents.has_table {
            self.fault(&name, None, "the table of the pack is damaged");
        }
        let mut window = Window::new(&objects.files, &path);
        let mut bad = Vec::new();
        for entry in &contents.entries {
            self.go_on()?;
            let count = match entry.kind {
                Kind::Blob => &mut self.report.blobs,
                Kind::Record => &mut self.report.records,
                Kind::Memo => &mut self.report.memos,
            };
            *count += 1;
            self.places
                .push((entry.id, entry.kind, number, entry.offset, entry.len));
            if entry.kind == Kind::Blob && !self.options.read_data.has(&entry.id) {
                continue;
            }
            let payload = window.payload(entry)?;
            self.report.verified_bytes += payload.len() as u64;
            let is_whole = pack::open(entry.kind, &entry.id, payload).is_some() && window.has_head(entry)?;
            if !is_whole {
                bad.push(*entry);
            }
        }
        for entry in &bad {
            let what = match entry.kind {
                Kind::Blob => "the bytes do not have their digest",
                _ => "the bytes do not have their checksum",
            };
            self.fault(&name, Some(entry.id), what);
        }
        if !bad.is_empty() || !contents.has_table {
            self.packs.insert(file.to_owned(), (contents, bad));
        }
        Ok(())
    }

    /// Compares every row of the index with the packs.
    fn index(&mut self, files: &[String]) -> Result<(), StoreError> {
        if self.store.objects.index.fault().is_some() {
            self.is_index_wrong = true;
            self.fault("index.sqlite", None, "the index is damaged");
            self.places = Vec::new();
            return Ok(());
        }
        self.places.sort_unstable();
        let segments: BTreeMap<i64, (Option<usize>, u64)> = self
            .store
            .objects
            .index
            .segments()?
            .into_iter()
            .map(|(id, file, base)| (id, (files.binary_search(&file).ok(), base)))
            .collect();
        let (mut wrong, mut unplaced) = (Vec::new(), Vec::new());
        let places = &self.places;
        self.store.objects.index.for_each(|row| {
            let Some((number, base)) = segments.get(&row.segment) else {
                unplaced.push((row.segment, row.id));
                return;
            };
            // Rows of a pack that came or went since the packs were listed are not judged.
            let Some(number) = number else { return };
            let offset = base.saturating_add(row.offset);
            let place = (row.id, row.kind, *number as u32, offset, row.len);
            if places.binary_search(&place).is_err() {
                wrong.push(row.id);
            }
        })?;
        // A segment that was added since the segments were read is known now.
        let known: BTreeSet<i64> = self
            .store
            .objects
            .index
            .segments()?
            .into_iter()
            .map(|(id, ..)| id)
            .collect();
        let unplaced = unplaced
            .into_iter()
            .filter(|(segment, _)| !known.contains(segment));
        wrong.extend(unplaced.map(|(_, id)| id));
        for id in wrong {
            self.is_index_wrong = true;
            self.fault(
                "index.sqlite",
                Some(id),
                "the index names a place without the object",
            );
        }
        let unindexed = self.unindexed()?;
        for id in unindexed {
            self.is_index_wrong = true;
            self.fault("index.sqlite", Some(id), "the index lacks the pack of the object");
        }
        self.places = Vec::new();
        Ok(())
    }

    /// Returns an object of each pack that the index does not know.
    fn unindexed(&self) -> Result<Vec<Digest>, StoreError> {
        let index = &self.store.objects.index;
        let known: BTreeSet<String> = index.segments()?.into_iter().map(|(_, file, _)| file).collect();
        if self.store.is_read_only() || known.is_empty() {
            return Ok(Vec::new());
        }
        let unknown = index.listed()?.difference(&known).cloned().collect::<Vec<_>>();
        let first = |file: &String| {
            let contents = pack::contents(&self.store.objects.files, &self.store.objects.pack_path(file))?;
            Ok(contents.and_then(|contents| contents.entries.first().map(|entry| entry.id)))
        };
        unknown.iter().map(first).filter_map(Result::transpose).collect()
    }

    /// Checks that everything that records name exists, and lists the results that the faults break.
    fn records(&mut self) -> Result<(), StoreError> {
        let store = self.store;
        let broken: HashSet<Digest> = self
            .report
            .faults
            .iter()
            .filter_map(|fault| fault.object)
            .collect();
        let mut breaks: BTreeMap<Digest, Vec<(String, Digest)>> = BTreeMap::new();
        let mut missing = BTreeSet::new();
        for key in store.objects.index.ids(Kind::Record)? {
            self.go_on()?;
            let json = store.objects.whole_payload(Kind::Record, &key)?;
            let Some(record) = json.and_then(|json| Record::decode(&json)) else {
                continue;
            };
            let named = record.objects().chain([record.key]).collect::<BTreeSet<_>>();
            for digest in named {
                let is_missing = !store.objects.contains(&digest);
                if is_missing {
                    missing.insert(digest);
                }
                if is_missing || broken.contains(&digest) {
                    let result = (record.stage.clone(), record.key);
                    breaks.entry(digest).or_default().push(result);
                }
            }
        }
        for digest in missing {
            if !broken.contains(&digest) {
                let path = self.below(&store.objects.loose_path(&digest));
                self.fault(
                    path,
                    Some(digest),
                    "a record names a blob that is not in the store",
                );
            }
        }
        for fault in &mut self.report.faults {
            if let Some(results) = fault.object.and_then(|object| breaks.get(&object)) {
                fault.breaks.clone_from(results);
            }
        }
        Ok(())
    }

    fn runs(&mut self) -> Result<(), StoreError> {
        let dir = self.store.runs_dir();
        let files = &self.store.objects.files;
        for run in runs::list(files, &dir)? {
            self.report.runs += 1;
            match runs::read(files, &dir, &run)? {
                Err(path) => self.fault(self.below(&path), None, "the run root is damaged"),
                Ok(root) => self.documents(run.number, &root),
            }
        }
        Ok(())
    }

    /// Looks for the documents that a run root names.
    fn documents(&mut self, run: u64, root: &[u8]) {
        for (name, document) in runs::documents(root) {
            let digest = document.digest;
            if !self.store.objects.contains(&digest) {
                self.report
                    .lost_documents
                    .push(LostDocument { run, name, digest });
            }
        }
    }

    fn repair(&mut self) -> Result<(), StoreError> {
        let store = self.store;
        let objects = &store.objects;
        objects.staging()?;
        for fault in &self.report.faults {
            let path = store.dir.join(&fault.file);
            if fault.file.starts_with("cas")
                && let Some(digest) = fault.object
                && path.exists()
            {
                objects.quarantine_loose(&digest, &path);
            }
        }
        let guard = objects
            .locks
            .take(Lock::Rewrite, Share::Exclusive, &objects.notices)?;
        for (file, (contents, bad)) in &self.packs {
            if objects.files.meta(&objects.pack_path(file)).is_none() {
                continue;
            }
            objects.replace_pack(&guard, file, contents, bad)?;
        }
        drop(guard);
        if self.is_index_wrong {
            objects.index.rebuild("a check found it wrong")?;
        }
        for number in store.run_numbers()? {
            match store.run(number) {
                Ok(_) | Err(StoreError::DamagedRun { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        if self
            .report
            .faults
            .iter()
            .any(|fault| fault.file == std::path::Path::new("format"))
        {
            super::open::write_format(&store.dir, &objects.files, &objects.notices)?;
        }
        self.report.is_repaired = objects.access == Access::ReadWrite;
        Ok(())
    }
}
