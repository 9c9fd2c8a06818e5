//! A crate as it is found: bag, graph and run root.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use marf_cache::manifest::Row;
use marf_cache::{Action, Digest};
use marf_engine::{Cancel, NodeRun, RunRecord};
use marf_stage::PHOTOS;
use serde_json::Value;

use crate::bag::{Bag, FileDigest, PAYLOAD, read_member};
use crate::contents::{RUN_ROOT, rows};
use crate::error::ExportError;
use crate::graph::{CRATE_FORMAT, CRATE_PROFILE, METADATA, ids};
use crate::run::check_finished;

/// An opened crate. Its contents are not trusted.
pub struct OpenCrate {
    /// The bag, with its faults.
    pub bag: Bag,
    /// The entities of the graph, in its order.
    pub entities: Vec<Value>,
    /// The bytes of the run root.
    pub root: Vec<u8>,
    /// The run that it describes.
    pub run: RunRecord,
    /// Paths of the payload by the digest of their bytes.
    paths: BTreeMap<Digest, String>,
}

/// A folder that cannot be checked.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// There is no folder.
    #[error("there is no folder {}", path.display())]
    NoFolder {
        /// The folder.
        path: PathBuf,
    },
    /// There is no crate.
    #[error("{} is not a crate: {cause}", path.display())]
    NoCrate {
        /// The folder.
        path: PathBuf,
        /// What is missing.
        cause: String,
    },
    /// An RO-Crate that another program made.
    #[error("{} is an RO-Crate that marf did not make", path.display())]
    Foreign {
        /// The folder.
        path: PathBuf,
    },
    /// A crate of a newer form.
    #[error("{} is a crate of version {found}: this program reads up to {CRATE_FORMAT}", path.display())]
    Newer {
        /// The folder.
        path: PathBuf,
        /// Its version, as it says.
        found: String,
    },
    /// The run root cannot be read.
    #[error("the run root of {}: {cause}", path.display())]
    BadRun {
        /// The folder.
        path: PathBuf,
        /// The fault.
        cause: ExportError,
    },
    /// The user wants to stop.
    #[error("stopped")]
    Stopped,
}

impl OpenCrate {
    /// Reads a crate. Every file is read once and compared with the bag's manifests.
    ///
    /// # Errors
    /// A folder without a readable graph or run root, or a crate of a newer form. The wish of the user to
    /// stop.
    pub fn open(folder: &Path, cancel: &Cancel) -> Result<Self, OpenError> {
        let path = || folder.to_owned();
        if !folder.is_dir() {
            return Err(OpenError::NoFolder { path: path() });
        }
        let no_crate = |cause: String| OpenError::NoCrate { path: path(), cause };
        let metadata = format!("{PAYLOAD}/{METADATA}");
        let bytes = read_member(folder, &metadata)
            .map_err(|error| no_crate(format!("{}: {error}", folder.join(&metadata).display())))?;
        let graph: Value = serde_json::from_slice(&bytes)
            .map_err(|error| no_crate(format!("`{METADATA}` is damaged: {error}")))?;
        let entities = graph["@graph"].as_array().cloned().unwrap_or_default();
        check_version(folder, &entities)?;
        let bag = Bag::read(folder, cancel);
        if cancel.is_set() {
            return Err(OpenError::Stopped);
        }
        let root = bag
            .get(RUN_ROOT)
            .map_err(|error| no_crate(format!("`{RUN_ROOT}`: {error}")))?;
        let bad = |cause: ExportError| OpenError::BadRun { path: path(), cause };
        let run = RunRecord::decode(&root).map_err(|cause| bad(cause.into()))?;
        check_finished(&run).map_err(bad)?;
        let paths = bag
            .payload
            .iter()
            .map(|(path, digest)| (digest.blake3, path.clone()))
            .collect();
        Ok(Self {
            bag,
            entities,
            root,
            run,
            paths,
        })
    }

    /// Returns the bytes of an object that the payload holds. The error is a sentence.
    ///
    /// # Errors
    /// An object that is not there or cannot be read.
    pub fn object(&self, digest: &Digest) -> Result<Arc<[u8]>, String> {
        let path = self.paths.get(digest).ok_or("it is not in the crate")?;
        let bytes = self.bag.get(path).map_err(|error| error.to_string())?;
        // The file may have changed since the bag was read.
        if Digest::from_content(&bytes) != *digest {
            return Err("it changed while it was read".to_owned());
        }
        Ok(bytes.into())
    }

    /// Reads the action of a node: its bytes have the digest that is the key. The error is a sentence.
    ///
    /// # Errors
    /// An action that is not there or cannot be read.
    pub fn action(&self, node: &NodeRun) -> Result<Action, String> {
        let key = node.key.ok_or("it has no key")?;
        Action::decode(&self.object(&key)?).map_err(|error| error.to_string())
    }

    /// Reads the photos that a node gives. `None` if it gives none.
    ///
    /// # Errors
    /// A set that is not there or cannot be read.
    pub fn photos(&self, node: &NodeRun) -> Result<Option<Vec<Row>>, ExportError> {
        let Some(output) = node.outputs.get(PHOTOS) else {
            return Ok(None);
        };
        let what = format!("`{PHOTOS}` of `{}`", node.name);
        rows(&output.digest, &|digest| self.object(digest), &what).map(Some)
    }

    /// Returns the photos that a node gives, as far as they can be read.
    pub fn rows(&self, node: &NodeRun) -> Vec<Row> {
        self.photos(node).ok().flatten().unwrap_or_default()
    }

    /// Returns true if the payload holds the bytes of this digest.
    pub fn holds(&self, digest: &Digest) -> bool {
        self.paths.contains_key(digest)
    }

    /// Returns the entities of a type.
    pub fn of_type<'a>(&'a self, kind: &'a str) -> impl Iterator<Item = &'a Value> {
        self.entities.iter().filter(move |entity| is(entity, kind))
    }

    /// Returns the digests that the graph gives of each file, by the file's id.
    pub fn described(&self) -> BTreeMap<&str, FileDigest> {
        let files = self.of_type("File");
        files
            .filter_map(|file| Some((text(file, "@id"), digests(file)?)))
            .collect()
    }

    /// Returns the number of files that are named by their digests and not included: results, and objects of photos.
    pub fn named(&self) -> usize {
        let files = self.described().into_iter();
        let named = files.filter(|(id, _)| id.contains(':'));
        let mut named: BTreeSet<Digest> = named.map(|(_, file)| file.blake3).collect();
        let rows = self.run.nodes.iter().flat_map(|node| self.rows(node));
        let photos = rows.flat_map(|row| row.blobs.into_values());
        named.extend(photos.filter(|photo| !self.holds(photo)));
        named.len()
    }
}

/// Refuses a folder that is not a crate of ours, or of a newer form.
fn check_version(folder: &Path, entities: &[Value]) -> Result<(), OpenError> {
    let root = entities.iter().find(|entity| text(entity, "@id") == "./");
    let profiles = root.map(|root| ids(&root["conformsTo"])).unwrap_or_default();
    let version = profiles.iter().find_map(|id| id.strip_prefix(CRATE_PROFILE));
    let path = folder.to_owned();
    match version.map(|version| (version, version.parse::<u32>())) {
        Some((_, Ok(known))) if known <= CRATE_FORMAT => Ok(()),
        Some((found, _)) => Err(OpenError::Newer {
            path,
            found: found.to_owned(),
        }),
        None => Err(OpenError::Foreign { path }),
    }
}

/// Returns a text field of an entity. Empty if it has none.
pub(super) fn text<'a>(entity: &'a Value, field: &str) -> &'a str {
    entity[field].as_str().unwrap_or_default()
}

/// Returns true if an entity is of a type.
pub(super) fn is(entity: &Value, kind: &str) -> bool {
    match &entity["@type"] {
        Value::Array(kinds) => kinds.iter().any(|found| found == kind),
        found => found == kind,
    }
}

/// Returns length and digests that the graph gives of a file.
fn digests(file: &Value) -> Option<FileDigest> {
    Some(FileDigest {
        bytes: text(file, "contentSize").parse().ok()?,
        sha256: text(file, "sha256").parse().ok()?,
        blake3: text(file, "blake3").parse().ok()?,
    })
}
