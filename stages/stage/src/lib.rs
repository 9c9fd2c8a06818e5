//! The contract between a stage and the engine.
//!
//! A stage is a pure function with a name and a version: its result depends on its parameters and on the
//! contents of its inputs, and on nothing else (no clock, no path, no thread count). Invariant: everything
//! that a stage reads from outside comes through [`Ctx`] or, for a [`Source`], is part of its fingerprint.

mod archive;
mod ctx;
mod define;
mod document;
mod error;
pub mod format;
pub mod harness;
mod origin;
mod set;
mod sols;
mod verdict;

use std::{collections::BTreeMap, sync::Arc};

use marf_cache::{Digest, canonical_json, manifest::Row};
use serde::{Deserialize, Serialize};

pub use archive::{Access, ArchiveContext, LOCK_FILE, RecordedArchive};
pub use ctx::{Blobs, Cancel, Checkpoints, Ctx, Keep, Memos, Progress};
pub use define::{Define, Port, StageDef, define, from_json, key_params, schema_of};
pub use document::{Document, Params, TypedOutputs};
pub use error::{BlobError, ParamError, StageError};
pub use origin::{Origin, OriginKind};
pub use set::rows_of;
pub use sols::Sols;
pub use verdict::Verdict;

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
    /// Returns the parameters that may change the result, defaults included, as JSON ([`key_params`]). They are part of the
    /// key.
    fn params(&self) -> serde_json::Value;
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
    /// Returns the [`Stage::backend_id`] on another machine: one whose GPU has the id `gpu`, or one without a GPU.
    ///
    /// # Errors
    /// Returns an error if a GPU is wanted that the machine does not have.
    fn backend_id_on(&self, _gpu: Option<&str>) -> Result<Option<String>, StageError> {
        Ok(None)
    }
    /// Returns the name of the output of the stage's own last finished run that it reads as the input [`EARLIER`]. That
    /// output is then part of the key. At the first run it is absent.
    fn earlier(&self) -> Option<&'static str> {
        None
    }
}

/// The kinds of work, by what is cached.
pub enum Work<'a> {
    /// Reads items from an archive, with one record a shard.
    Source(&'a dyn Source),
    /// Accepts or rejects each item by its measure. Measures are cached by item.
    Map(&'a dyn Map),
    /// Accepts or rejects items with a state from all earlier shards, with one record a shard.
    Fold(&'a dyn Fold),
    /// Needs all its inputs at once, and makes one record.
    Set(&'a dyn Set),
    /// Requests further nodes, in one round or several, and reduces their outputs to one record.
    Expand(&'a dyn Expand),
}

/// How many threads a run can use. Fewer never change the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Threads {
    /// One. Other nodes run at the same time.
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

    /// Returns the outputs that several nodes give as this input ([`Port::many`]): the name of each, and its
    /// digest.
    pub fn each<'a>(&'a self, name: &str) -> impl Iterator<Item = (&'a str, &'a Digest)> {
        let prefix = format!("{name}/");
        self.0
            .iter()
            .filter_map(move |(name, digest)| Some((name.strip_prefix(&prefix)?, digest)))
    }

    /// Returns the digest of an input that may be absent.
    pub fn optional(&self, name: &str) -> Option<&Digest> {
        self.0.get(name)
    }
}

/// One part of a source, in order: a sol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shard {
    /// The sol, or 0 without one.
    pub shard: u32,
    /// Digest of everything that [`Source::fetch`] would read for it, as far as it is known: see
    /// [`Fetched::fingerprint`].
    pub fingerprint: Digest,
}

/// The files of a shard: digests of their bytes by name.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Files(pub BTreeMap<String, Digest>);

impl Files {
    /// Returns the one form as bytes: canonical JSON.
    pub fn encode(&self) -> Vec<u8> {
        // Names and digests always serialise.
        canonical_json(&serde_json::to_value(self).unwrap_or_default())
    }

    /// Reads a list that [`Files::encode`] wrote, or returns `None` for other bytes.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        serde_json::from_slice(bytes).ok()
    }
}

/// What an archive offers now.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Listing {
    /// Sorted by shard.
    pub shards: Vec<Shard>,
    /// Companion files of the photos (cameras of another program), by relative name. Their bytes are in the store.
    pub companions: BTreeMap<String, Digest>,
    /// The amount of data to fetch, as text (`90 files to fetch`). Not part of the key.
    pub note: Option<String>,
    /// Where it is, in words (folder `photos`). Not part of the key.
    pub place: Option<String>,
    /// Warnings about the listing (a pin that cannot be read), one sentence each. Not part of the key.
    pub warnings: Vec<String>,
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
    /// One verdict for every file seen. A file without an item has the reason.
    pub verdicts: Vec<Verdict>,
    /// Measures that were made of items while they were in memory, so that no stage reads the items again for them.
    pub measures: Vec<FetchedMeasure>,
    /// Digest of everything that was read, if the listing could not know it: the bytes of a shard on a server are known
    /// only after the fetch. The result is kept under it, and the next listing gives it as [`Shard::fingerprint`].
    pub fingerprint: Option<Digest>,
    /// The files that were read and where they came from, in the order of reading. Kept with the result.
    pub origins: Vec<Origin>,
    /// What people should know of the work, one sentence each.
    pub warnings: Vec<String>,
}

/// A measure that a source made of an item.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FetchedMeasure {
    /// The item.
    pub id: String,
    /// The table that keeps it.
    pub table: Table,
    /// What [`Measure::measure`] would return of the item for this table.
    pub measure: Vec<u8>,
}

/// Reads items from an archive.
pub trait Source: Send + Sync {
    /// Lists the shards. Cheap, because it runs at every plan. It may load memos but saves no memo.
    ///
    /// # Errors
    /// Returns an error if the archive is missing or unreadable.
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError>;

    /// Returns the files that [`Source::fetch`] would read of a listed shard, or `None` if they are known only after the
    /// fetch. Then [`Shard::fingerprint`] is the digest of [`Files::encode`], which `fetch` stores, so that the changed
    /// files can be listed after an earlier run.
    ///
    /// # Errors
    /// Returns an error if the shard does not exist or the archive is unreadable.
    fn files(&self, _ctx: &Ctx<'_>, _shard: u32) -> Result<Option<Files>, StageError> {
        Ok(None)
    }

    /// Reads one shard. Runs when its fingerprint is new.
    ///
    /// # Errors
    /// Returns an error only if the whole shard fails. A bad file is a verdict.
    fn fetch(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError>;
}

/// A table of measures: one value an item, a pure function of the item. It is kept by shard under this name and version.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Table {
    /// Its name, unique among all tables.
    pub name: &'static str,
    /// Raised by hand when a value may differ.
    pub version: u32,
}

/// Measures items one by one.
pub trait Measure: Send + Sync {
    /// Returns the table that this stage reads, or `None` if it needs only the rows.
    fn table(&self) -> Option<Table>;

    /// Returns the tables that one look at an item can fill, [`Measure::table`] among them. Several stages may return the
    /// same ones: the first of them that runs fills all.
    fn together(&self) -> Vec<Table> {
        self.table().into_iter().collect()
    }

    /// Measures one item for each of the wanted tables, some of [`Measure::together`]: pure functions of the row and the
    /// bytes it names, cached by them. No parameter changes a measure.
    ///
    /// Large parts of a measure may be blobs of their own, stored through `ctx`, and named by [`Measure::blobs`].
    ///
    /// # Errors
    /// Returns an error only if the whole node fails. An item that cannot be measured has a measure that says so.
    fn measure(&self, ctx: &Ctx<'_>, row: &Row, wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError>;

    /// Returns the blobs that a measure names. One that is lost makes the item be measured again.
    fn blobs(&self, _measure: &[u8]) -> Vec<Digest> {
        Vec::new()
    }
}

/// An item with its measure.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// Its shard.
    pub shard: u32,
    /// The item.
    pub row: &'a Row,
    /// The result of [`Measure::measure`]. Empty without a table.
    pub measure: &'a [u8],
}

/// Accepts or rejects each item by its measure.
pub trait Map: Measure {
    /// Returns how items are compared with each other, or `None` if a verdict depends on its item alone. A new shard
    /// then changes no verdict on another.
    fn comparison(&self) -> Option<&dyn Comparison> {
        None
    }

    /// Returns one verdict for each item of a shard, in the same order. Cheap: runs whenever a threshold changes.
    ///
    /// `context` is that of the last pass of [`Map::comparison`]. Empty without a comparison.
    ///
    /// # Errors
    /// Returns an error if a measure or a context cannot be read.
    fn decide(&self, context: &[u8], items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError>;
}

/// Compares the items of a set with each other without holding them all. In each pass every shard is summarised, and the
/// summaries become a context for the next pass and finally for the decision.
///
/// A new shard is summarised alone. If the context comes out equal, it is also decided alone. Otherwise all shards are
/// decided again, from kept measures.
pub trait Comparison: Send + Sync {
    /// Returns the names of the passes, in order, at least one. A name identifies a summary: no parameter changes a summary
    /// of the same name, context and shard.
    fn passes(&self) -> Vec<&'static str>;

    /// Returns the summary of the items of a shard in a pass, independent of their order: bytes whose number depends on
    /// this shard alone. `context` is that of the pass before. Empty in the first.
    ///
    /// # Errors
    /// Returns an error if a measure or a context cannot be read.
    fn summarise(&self, pass: usize, context: &[u8], items: &[Measured<'_>]) -> Result<Vec<u8>, StageError>;

    /// Returns the context after a pass from the summaries of all shards, independent of their order and of how items are
    /// spread over them. `context` is that of the pass before. Empty in the first.
    ///
    /// Equal contexts have equal bytes. They hold only data that can change a later pass or a verdict, because every other
    /// difference would make all shards be decided again.
    ///
    /// # Errors
    /// Returns the first error of `summaries`, or an error if a summary or a context cannot be read.
    fn context(
        &self,
        pass: usize,
        context: &[u8],
        summaries: &mut dyn Iterator<Item = Result<Arc<[u8]>, StageError>>,
    ) -> Result<Vec<u8>, StageError>;
}

/// Accepts or rejects items shard by shard, each with what earlier shards added to a state.
pub trait Fold: Measure {
    /// Returns the state before the first shard.
    fn begin(&self) -> Box<dyn FoldState + '_>;
}

/// The state of a fold between two shards.
pub trait FoldState {
    /// Adds the bytes that [`FoldState::fold`] returned of the next shard in an earlier run, instead of folding
    /// it again.
    ///
    /// # Errors
    /// Returns an error if `fold` did not return these bytes.
    fn replay(&mut self, ctx: &Ctx<'_>, added: &[u8]) -> Result<(), StageError>;

    /// Decides the items of the next shard. Returns their addition to the state (of a size that depends on this shard
    /// alone, never on earlier ones) and one verdict for each item, in the same order.
    ///
    /// # Errors
    /// A measure that cannot be read.
    fn fold(&mut self, ctx: &Ctx<'_>, items: &[Measured<'_>]) -> Result<(Vec<u8>, Vec<Verdict>), StageError>;

    /// Returns the blobs that `added` names.
    fn blobs(&self, _added: &[u8]) -> Vec<Digest> {
        Vec::new()
    }
}

/// Computes outputs from whole inputs.
pub trait Set: Send + Sync {
    /// Computes the outputs.
    ///
    /// # Errors
    /// Returns the reason why the node stops, or [`StageError::Cancelled`] when asked to stop.
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError>;
}

/// Requests further nodes, in one round or several, and reduces their outputs.
pub trait Expand: Send + Sync {
    /// Returns every stage that a child may be of, each with parameters that choose the backend as the child's do. Their
    /// versions and backends are part of the key of this node.
    fn children(&self) -> Vec<ChildStage>;

    /// Returns the nodes to run first.
    ///
    /// # Errors
    /// Inputs that no node can be derived from.
    fn expand(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError>;

    /// Returns the nodes of the next round, which may have outputs of earlier ones as inputs. Empty if the outputs can be
    /// computed.
    ///
    /// It is called each time all nodes requested so far have run. `done` holds their outputs in the order of the requests,
    /// round after round. The answer depends on parameters, inputs and `done` alone, so that a run that goes on after a
    /// stop asks for the same nodes.
    ///
    /// # Errors
    /// Returns an error if no node can be derived from the outputs.
    fn further(
        &self,
        _ctx: &Ctx<'_>,
        _inputs: &Inputs,
        _done: &[Outputs],
    ) -> Result<Vec<NodeSpec>, StageError> {
        Ok(Vec::new())
    }

    /// Computes the outputs from those of the nodes of all rounds, which come in the order of the requests.
    ///
    /// # Errors
    /// What stops the node.
    fn reduce(&self, ctx: &Ctx<'_>, inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError>;
}

/// A stage that children of a node are of.
#[derive(Debug, Clone, PartialEq)]
pub struct ChildStage {
    /// Name of the stage in the table.
    pub stage: &'static str,
    /// Parameters of such a child, as JSON.
    pub params: serde_json::Value,
}

impl ChildStage {
    /// Returns the stage of children with such parameters.
    pub fn new<P: Params>(params: &P) -> Self {
        Self {
            stage: P::STAGE,
            params: key_params(params, &[]),
        }
    }
}

/// A request to run a stage with parameters on inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeSpec {
    /// Name below the requesting node, unique there over all rounds (`trial-03`).
    pub name: String,
    /// Name of the stage in the table.
    pub stage: String,
    /// Its parameters as JSON. They are checked when the stage is bound.
    pub params: serde_json::Value,
    /// Its inputs.
    pub inputs: Inputs,
}
