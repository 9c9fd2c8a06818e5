//! What the program gives the page.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use marf_cache::Digest;

/// The store, as far as the page reads it.
pub trait Source: Send + Sync {
    /// Returns the number of the run to show now; none if there is none.
    fn newest(&self) -> Option<u64>;

    /// Reads the run to show now.
    ///
    /// # Errors
    /// One sentence.
    fn content(&self) -> Result<RunContent, String>;

    /// Reads the run of a number, which a page that is open elsewhere still shows.
    ///
    /// # Errors
    /// One sentence: no such run, or one that cannot be read.
    fn content_of(&self, run: u64) -> Result<RunContent, String>;

    /// Reads an object; none if the store does not have it.
    fn object(&self, digest: &Digest) -> Option<Arc<[u8]>>;

    /// Returns the folder in which running programs leave their events.
    fn event_folder(&self) -> PathBuf;
}

/// A run as it is shown.
pub struct RunContent {
    /// Its number; none if there is no run yet.
    pub number: Option<u64>,
    /// Its report, HTML as `report.html` has it.
    pub report: String,
    /// The pages of its scenes by file name, in the form of the report; the report links to them as `pages/NAME`.
    pub pages: BTreeMap<String, Digest>,
    /// The objects that it names.
    pub objects: BTreeSet<Digest>,
    /// Its trained fields, or those of an earlier run.
    pub fields: Vec<FieldSource>,
}

/// A trained field of a run.
#[derive(Debug, Clone)]
pub struct FieldSource {
    /// The node that trained it, as it is shown.
    pub node: String,
    /// The field.
    pub weights: Digest,
    /// Its scene.
    pub scene: Digest,
    /// Fields of the retrainings whose uncertainty is shown; empty if there are none.
    pub members: Vec<Digest>,
    /// What makes an interval of how far their depths differ; none where photos held out do not tell it.
    pub depth_interval: Option<DepthInterval>,
}

/// 90 % of the errors of a depth are at most factor √(spread² + floor²), all as shares of the depth: fitted by the bootstrap on photos
/// held out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthInterval {
    /// Least spread.
    pub floor: f64,
    /// Widths of the interval's half.
    pub factor: f64,
}
