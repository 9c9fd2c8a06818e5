//! Every byte of a lineage against its digest, and every statement of its run root against the objects.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::{Digest, FsckOptions, FsckReport, MissingObject, ReadShare, Sha256, Store};
use marf_model::{Run, RunError, RunNode, product::origins, unless_lost};
use serde::Serialize;

/// Result of a verification.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Verified {
    /// Objects of the lineage that are in the store: records and blobs.
    pub objects: u64,
    /// Their bytes, all of which were read.
    pub bytes: u64,
    /// Products of archives whose SHA-256 was compared too.
    pub products: u64,
    /// Contents that disagree with their digest or with the run root.
    pub faults: Vec<Fault>,
    /// Named objects that are not in the store: collected or lost.
    pub missing: Vec<Lost>,
}

/// Something that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// The object, or the key of a record. `None` for a fault of the run root.
    pub object: Option<Digest>,
    /// Whose it is, or the file of the store.
    pub of: String,
    /// The fault.
    pub what: String,
}

/// An object that is named and not in the store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Lost {
    /// The blob, or the key of the record.
    pub digest: Digest,
    /// Role under which it is named (`output`, `record`).
    pub role: &'static str,
    /// The node whose it is, as far as that is known, else the key or set that names it.
    pub of: String,
}

/// Reads every file of a store and compares it with its digests. Nothing is changed or set aside, so this comes before all
/// other reading: what that finds damaged is set aside, and then only missing.
///
/// # Errors
/// A store that cannot be read.
pub fn check(store: &Store) -> Result<FsckReport, RunError> {
    Ok(store.fsck(FsckOptions {
        read_data: ReadShare::ALL,
        repair: false,
    })?)
}

/// Compares all contents and inputs of some nodes of a run, and the run's documents, with their digests and
/// with the run root. `check` is the result of [`check`].
///
/// # Errors
/// A store that cannot be read. Faults are not errors.
pub fn verify(run: &Run<'_>, nodes: &[&RunNode], check: &FsckReport) -> Result<Verified, RunError> {
    let store = run.store();
    let damaged: BTreeMap<Digest, (String, &str)> = check
        .faults
        .iter()
        .filter_map(|fault| Some((fault.object?, (fault.file.display().to_string(), fault.what))))
        .collect();
    let keys: Vec<Digest> = nodes.iter().filter_map(|node| node.run.key).collect();
    let closure = store.closure(&keys, &run.documents())?;
    let mut verified = Verified {
        objects: (closure.keys.len() + closure.blobs.len()) as u64,
        bytes: closure.bytes,
        ..Verified::default()
    };
    let is_named = |object: &Digest| {
        let missing = closure.missing.iter().any(|missing| missing.digest == *object);
        missing || closure.keys.binary_search(object).is_ok() || closure.blobs.binary_search(object).is_ok()
    };
    for (object, (file, what)) in damaged.iter().filter(|(object, _)| is_named(object)) {
        verified.fault(Some(*object), file, *what);
    }
    let is_lost = |missing: &&MissingObject| !damaged.contains_key(&missing.digest);
    verified.missing = closure
        .missing
        .iter()
        .filter(is_lost)
        .map(|missing| named(nodes, missing))
        .collect();
    for node in nodes {
        statements(node, &mut verified);
    }
    for source in nodes.iter().filter(|node| node.is_source()) {
        files(store, source, &damaged, &mut verified)?;
    }
    Ok(verified)
}

impl Verified {
    /// Returns the faults of whole files of the store: run roots, tables of packs, the index, the format.
    pub fn from_files(check: &FsckReport) -> Self {
        let mut verified = Self::default();
        for fault in check.faults.iter().filter(|fault| fault.object.is_none()) {
            verified.fault(None, &fault.file.display().to_string(), fault.what);
        }
        verified
    }

    /// Merges the results of two verifications.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        self.objects += other.objects;
        self.bytes += other.bytes;
        self.products += other.products;
        self.faults.extend(other.faults);
        self.missing.extend(other.missing);
        self
    }

    fn fault(&mut self, object: Option<Digest>, of: &str, what: impl Into<String>) {
        self.faults.push(Fault {
            object,
            of: of.to_owned(),
            what: what.into(),
        });
    }
}

fn named(nodes: &[&RunNode], missing: &MissingObject) -> Lost {
    let node = nodes.iter().find(|node| node.run.key == Some(missing.named_by));
    Lost {
        digest: missing.digest,
        role: missing.role,
        of: node.map_or_else(|| missing.named_by.short(), |node| node.run.name.clone()),
    }
}

/// Compares what the run root says of a node with its action and its record.
fn statements(node: &RunNode, verified: &mut Verified) {
    let (name, key) = (node.run.name.as_str(), node.run.key);
    if let Some(action) = &node.action {
        if Some(action.key()) != key {
            verified.fault(key, name, "the bytes of its action do not give its key");
        }
        let inputs: BTreeMap<_, _> = node
            .run
            .inputs
            .iter()
            .map(|(name, input)| (name.clone(), input.digest))
            .collect();
        if inputs != action.inputs {
            verified.fault(key, name, "the run root names other inputs than its action");
        }
    }
    if let Some(record) = &node.record {
        if node.run.state.is_good() && record.outputs != node.run.outputs {
            verified.fault(key, name, "the run root names other outputs than its record");
        }
        if Some(record.key) != key || record.stage != node.run.stage {
            verified.fault(key, name, "the record is of another result");
        }
    }
}

/// Compares the files that a source read with the digests that others know them by.
fn files(
    store: &Store,
    source: &RunNode,
    damaged: &BTreeMap<Digest, (String, &str)>,
    verified: &mut Verified,
) -> Result<(), RunError> {
    let mut seen = BTreeSet::new();
    for part in unless_lost(source.parts(store))?.into_iter().flatten() {
        for file in unless_lost(origins(store, &part))?.into_iter().flatten() {
            let is_read = !damaged.contains_key(&file.blake3) && seen.insert(file.blake3);
            let Some(sha256) = file.sha256.filter(|_| is_read) else {
                continue;
            };
            // A lost file is in `missing`.
            let Some(bytes) = unless_lost(store.get(&file.blake3).map_err(RunError::from))? else {
                continue;
            };
            verified.products += 1;
            if Sha256::from_content(&bytes) != sha256 || Some(bytes.len() as u64) != file.bytes {
                verified.fault(
                    Some(file.blake3),
                    &file.file,
                    "its SHA-256 is not the one noted when it was read",
                );
            }
        }
    }
    Ok(())
}
