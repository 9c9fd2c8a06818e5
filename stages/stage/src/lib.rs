//! The contract between a stage and the engine.
//!
//! A stage is a pure function with a name and a version: what it answers depends on its parameters and on the
//! contents of its inputs, and on nothing else (no clock, no path, no thread count). Invariant: everything a
//! stage can read of the outside comes through [`Ctx`] or, for a [`Source`], is part of its fingerprint.

mod archive;
mod ctx;
mod define;
mod document;
mod error;
pub mod harness;

use std::collections::BTreeMap;

use marf_cache::{ContentHash, Digest, manifest::Row};
use serde::{Deserialize, Serialize};

pub use archive::{Access, ArchiveContext, LOCK_FILE};
pub use ctx::{BlobError, Blobs, Cancel, Checkpoints, Ctx, Memos, Progress};
pub use define::{Define, ParamError, Port, StageDef, define, from_json, schema_of};
pub use document::{Document, Params, TypedOutputs};
pub use error::StageError;

/// Name of the output that holds a set of items as a Merkle root ([`marf_cache::manifest::Root`]).
pub const PHOTOS: &str = "photos";
/// Name of the output that holds one [`Verdict`] a line, for every item the stage examined.
pub const VERDICTS: &str = "verdicts";
/// Name of a source's output that maps the names of companion files to digests, as JSON.
pub const COMPANIONS: &str = "companions";
/// Name of the input that holds the stage's own output of its last finished run ([`Stage::earlier`]).
pub const EARLIER: &str = "earlier";

/// A stage with its parameters, ready to run.
pub trait Stage: Send + Sync {
    /// Returns the parameters that may change the result; they are hashed into the key.
    fn params(&self) -> &dyn ContentHash;
    /// Returns the kind of work, with the implementation to run.
    fn work(&self) -> Work<'_>;
    /// Returns how many threads one run can use.
    fn threads(&self) -> Threads {
        Threads::One
    }
    /// Returns the backend that computes the result where results differ from backend to backend: adapter, driver and
    /// interface of a GPU. `None` is the CPU, whose results are equal to the bit everywhere. It is part of the key.
    fn backend_id(&self) -> Option<String> {
        None
    }
    /// Returns the name of the output of the stage's own last finished run that it reads as the input [`EARLIER`]. That
    /// output is then part of the key; at the first run it is absent.
    fn earlier(&self) -> Option<&'static str> {
        None
    }
}

/// The kinds of work, by what is cached.
pub enum Work<'a> {
    /// Reads items from an archive; one record a shard.
    Source(&'a dyn Source),
    /// Accepts or rejects each item by its measure; measures are cached by item.
    Map(&'a dyn Map),
    /// Accepts or rejects items with a state from all earlier shards; one record a shard.
    Fold(&'a dyn Fold),
    /// Needs all its inputs at once; one record.
    Set(&'a dyn Set),
    /// Requests further nodes and reduces their outputs; one record.
    Expand(&'a dyn Expand),
}

/// How many threads a run can use; fewer never change the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Threads {
    /// One; other nodes run at the same time.
    One,
    /// As many as there are.
    All,
}

/// Outputs of a stage by name, each a digest in the store.
pub type Outputs = BTreeMap<String, Digest>;

/// Inputs of a stage, by the name of the upstream output.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inputs(pub BTreeMap<String, Digest>);

impl Inputs {
    /// Returns the digest of a required input.
    ///
    /// # Errors
    /// Names the input that is not connected.
    pub fn required(&self, name: &str) -> Result<&Digest, StageError> {
        self.0
            .get(name)
            .ok_or_else(|| StageError::new(format!("input `{name}` is not connected")))
    }

    /// Returns the digest of an input that may be absent.
    pub fn optional(&self, name: &str) -> Option<&Digest> {
        self.0.get(name)
    }
}

/// One part of a source, in order: a sol.
#[derive(Debug, Clone, PartialEq, Eq, ContentHash)]
pub struct Shard {
    /// The sol; 0 where there is none.
    pub shard: u32,
    /// Digest of everything that [`Source::fetch`] would read for it.
    pub fingerprint: Digest,
}

/// What an archive offers now.
#[derive(Debug, Clone, Default, PartialEq, Eq, ContentHash)]
pub struct Listing {
    /// Sorted by shard.
    pub shards: Vec<Shard>,
    /// Companion files of the photos (cameras of another program), by relative name; their bytes are in the store.
    pub companions: BTreeMap<String, Digest>,
    /// How much there is to fetch, for people (`90 files to fetch`); not part of the key.
    #[content_hash(skip)]
    pub note: Option<String>,
}

impl Listing {
    /// Returns a reason followed by the note, if there is one.
    pub fn noted(&self, reason: &str) -> String {
        match &self.note {
            Some(note) => format!("{reason}; {note}"),
            None => reason.to_owned(),
        }
    }
}

/// The items of one shard.
#[derive(Debug, Default)]
pub struct Fetched {
    /// The items, in any order.
    pub rows: Vec<Row>,
    /// One verdict for every file seen; files that gave no item say why.
    pub verdicts: Vec<Verdict>,
}

/// Reads items from an archive.
pub trait Source: Send + Sync {
    /// Lists the shards; cheap, runs at every plan.
    ///
    /// # Errors
    /// A missing or unreadable archive.
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError>;

    /// Reads one shard; runs when its fingerprint is new.
    ///
    /// # Errors
    /// Only failures of the whole shard; a bad file is a verdict.
    fn fetch(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError>;
}

/// Measures items one by one.
pub trait Measure: Send + Sync {
    /// Returns the parameters that the measure depends on; thresholds are not among them.
    fn measure_params(&self) -> &dyn ContentHash;

    /// Returns the name and version under which measures are cached where several stages share them; `measure_params`
    /// then holds everything the measure depends on. `None`: the stage's own name and version.
    fn shared(&self) -> Option<(&'static str, u32)> {
        None
    }

    /// Measures one item: a pure function of the row and the bytes it names, cached by them.
    ///
    /// # Errors
    /// Only failures of the whole node; an item that cannot be measured has a measure that says so.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError>;
}

/// An item with its measure.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// Its shard.
    pub shard: u32,
    /// The item.
    pub row: &'a Row,
    /// The result of [`Measure::measure`].
    pub measure: &'a [u8],
}

/// Accepts or rejects each item by its measure.
pub trait Map: Measure {
    /// Returns one verdict for each item, in the same order. Cheap: runs whenever a threshold changes.
    ///
    /// # Errors
    /// A measure that cannot be read.
    fn decide(&self, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError>;
}

/// Accepts or rejects items of one shard with a state from all earlier shards.
pub trait Fold: Measure {
    /// Returns the state for the next shard and one verdict for each item, in the same order.
    ///
    /// # Errors
    /// A state or measure that cannot be read.
    fn fold(
        &self,
        state: Option<&[u8]>,
        items: &[Measured<'_>],
    ) -> Result<(Vec<u8>, Vec<Verdict>), StageError>;
}

/// Computes outputs from whole inputs.
pub trait Set: Send + Sync {
    /// Computes the outputs.
    ///
    /// # Errors
    /// What stops the node; [`StageError::Cancelled`] when asked to stop.
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError>;
}

/// Requests further nodes and reduces their outputs.
pub trait Expand: Send + Sync {
    /// Returns the nodes to run.
    ///
    /// # Errors
    /// Inputs that no node can be derived from.
    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError>;

    /// Computes the outputs from those of the nodes, which come in the order of the requests.
    ///
    /// # Errors
    /// What stops the node.
    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError>;
}

/// A request to run a stage with parameters on inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeSpec {
    /// Name below the requesting node, unique there (`trial-03`).
    pub name: String,
    /// Name of the stage in the table.
    pub stage: String,
    /// Its parameters as JSON; they are checked when the stage is bound.
    pub params: serde_json::Value,
    /// Its inputs.
    pub inputs: Inputs,
}

/// Whether one item is kept or rejected, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The item's id; for a file that gave no item, its name.
    pub id: String,
    /// The file it came from.
    pub file: String,
    /// `keep`, or the name of the filter that rejected it; `decode` if it could not be decoded.
    pub verdict: String,
    /// The measure the verdict rests on, in the filter's own unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
    /// The threshold that the measure was compared with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// For duplicates, the item that is kept instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<String>,
    /// One sentence for people; empty for a plain `keep`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

impl Verdict {
    /// The verdict of an item that is kept.
    pub const KEEP: &'static str = "keep";

    /// Returns whether the item is kept.
    pub fn keeps(&self) -> bool {
        self.verdict == Self::KEEP
    }
}
