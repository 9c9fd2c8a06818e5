//! The contract between a stage and the engine.
//!
//! A stage is a pure function with a name and a version: what it answers depends on its parameters and on the
//! contents of its inputs, and on nothing else (no clock, no path, no thread count). Invariant: everything a
//! stage can read of the outside comes through [`Ctx`] or, for a [`Source`], is part of its fingerprint.

mod ctx;
mod define;
mod document;
mod error;
pub mod harness;

use std::collections::BTreeMap;

use marf_cache::{ContentHash, Digest, manifest::Row};
use serde::{Deserialize, Serialize};

pub use ctx::{BlobError, Blobs, Cancel, Checkpoints, Ctx, Memos, Progress};
pub use define::{Define, ParamError, Port, StageDef, define};
pub use document::{Document, Params, TypedOutputs};
pub use error::StageError;

/// Name of the output that holds a set of items as a Merkle root ([`marf_cache::manifest::Root`]).
pub const PHOTOS: &str = "photos";
/// Name of the output that holds one [`Verdict`] a line, for every item a set stage looked at.
pub const VERDICTS: &str = "verdicts";
/// Name of a source's output that maps names of files beside the photos to digests, as JSON.
pub const COMPANIONS: &str = "companions";
/// Name of the input that holds the stage's own output of its last finished run ([`Stage::earlier`]).
pub const EARLIER: &str = "earlier";

/// A stage with its parameters, ready to run.
pub trait Stage: Send + Sync {
    /// Everything of the parameters that may change the answer.
    fn params(&self) -> &dyn ContentHash;
    /// What kind of work this is.
    fn work(&self) -> Work<'_>;
    /// How many threads one run of it can use.
    fn threads(&self) -> Threads {
        Threads::One
    }
    /// Names what decides the bits of its numbers beside program and inputs: adapter, driver and interface of a GPU.
    /// `None` is the CPU, whose bits are the same everywhere. It is in the key.
    fn backend_id(&self) -> Option<String> {
        None
    }
    /// Names the output of its own that it wants of its last finished run, as the input [`EARLIER`]; that output
    /// is then in its key, and absent at the first run.
    fn earlier(&self) -> Option<&'static str> {
        None
    }
}

/// The grains of work.
pub enum Work<'a> {
    /// Brings items in from outside, one record a shard.
    Source(&'a dyn Source),
    /// Judges each item by a measure of its own; the measure is kept.
    Map(&'a dyn Map),
    /// Judges items in the light of all earlier shards, one record a shard.
    Fold(&'a dyn Fold),
    /// Needs all its inputs at once, one record.
    Set(&'a dyn Set),
    /// Asks for further nodes and reduces their outputs, one record.
    Expand(&'a dyn Expand),
}

/// How many threads a run can use; the engine may give fewer, never a different answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Threads {
    /// Runs beside others on one core.
    One,
    /// Shares out to as many as it gets.
    All,
}

/// Outputs of a stage by name, each a digest in the store.
pub type Outputs = BTreeMap<String, Digest>;

/// Contents that reach a stage, by the name of the output they come from.
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
    /// Digest of everything [`Source::fetch`] would read for it.
    pub fingerprint: Digest,
}

/// What a source has to offer now.
#[derive(Debug, Clone, Default, PartialEq, Eq, ContentHash)]
pub struct Listing {
    /// Sorted by shard.
    pub shards: Vec<Shard>,
    /// Files beside the photos (cameras of another program), by relative name; their bytes are in the store.
    pub companions: BTreeMap<String, Digest>,
    /// What bringing it would take, for people (`90 files to fetch`); not part of the key.
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

/// What one shard brought.
#[derive(Debug, Default)]
pub struct Fetched {
    /// The items, in any order.
    pub rows: Vec<Row>,
    /// One verdict for every file seen, also for those that gave no item and why.
    pub verdicts: Vec<Verdict>,
}

/// Brings items in from outside.
pub trait Source: Send + Sync {
    /// Lists what is there; cheap, runs at every plan.
    ///
    /// # Errors
    /// A missing or unreadable archive.
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError>;

    /// Brings one shard; runs when its fingerprint is new.
    ///
    /// # Errors
    /// Only what spoils the whole shard; a bad file is a verdict.
    fn fetch(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError>;
}

/// Measures items one by one.
pub trait Measure: Send + Sync {
    /// What of the parameters the measure depends on; thresholds are not among it.
    fn measure_params(&self) -> &dyn ContentHash;

    /// Name and version under which measures are kept, where several stages measure the same: what one of them has
    /// measured none measures again. `measure_params` then tells all that the measure depends on. `None`: the
    /// stage's own name and version.
    fn shared(&self) -> Option<(&'static str, u32)> {
        None
    }

    /// Measures one item; a pure function of the bytes behind the row, kept by them.
    ///
    /// # Errors
    /// Only what spoils the whole node; an item that cannot be measured is a measure that says so.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError>;
}

/// An item with its measure.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// The shard it is of.
    pub shard: u32,
    /// The item.
    pub row: &'a Row,
    /// What [`Measure::measure`] said.
    pub measure: &'a [u8],
}

/// Judges each item of a set by its measure.
pub trait Map: Measure {
    /// Returns one verdict for each item, in the same order. Cheap: runs whenever a threshold changes.
    ///
    /// # Errors
    /// A measure that cannot be read.
    fn decide(&self, items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError>;
}

/// Judges items of one shard in the light of a state from all earlier shards.
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

/// Turns whole inputs into outputs.
pub trait Set: Send + Sync {
    /// Runs to the end.
    ///
    /// # Errors
    /// What stops the node; [`StageError::Cancelled`] when asked to stop.
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError>;
}

/// Asks for further nodes and reduces their outputs.
pub trait Expand: Send + Sync {
    /// Returns the nodes it needs.
    ///
    /// # Errors
    /// Inputs from which no node can be drawn.
    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError>;

    /// Reduces the outputs of those nodes, given in the order they were asked for.
    ///
    /// # Errors
    /// What stops the node.
    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError>;
}

/// "Run this stage with these parameters on these inputs."
#[derive(Debug, Clone, PartialEq)]
pub struct NodeSpec {
    /// Name below the asking node, unique there (`trial-03`).
    pub name: String,
    /// Name of the stage in the table.
    pub stage: String,
    /// Its parameters as JSON, checked when bound.
    pub params: serde_json::Value,
    /// Its inputs.
    pub inputs: Inputs,
}

/// What became of one item, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The item's id; for a file that gave no item, its name.
    pub id: String,
    /// The file it came from.
    pub file: String,
    /// `keep`, or what rejected it (`decode`, `size`, `shape`, `duplicate`, `grayscale`, `histogram`, `blur`).
    pub verdict: String,
    /// The measure the verdict rests on, in the filter's own unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
    /// The threshold it was held against.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// The item that stays in its place, for duplicates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<String>,
    /// One sentence for people; empty for a plain `keep`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

impl Verdict {
    /// The verdict of an item that stays.
    pub const KEEP: &'static str = "keep";

    /// Tells whether the item stays.
    pub fn keeps(&self) -> bool {
        self.verdict == Self::KEEP
    }
}
