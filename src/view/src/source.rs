//! Interface through which the program gives the page its data.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use marf_cache::Digest;
use marf_report::{LinkedPage, LiveParts};

use crate::splat_progress::SplatProgress;

/// The store, as far as the page reads it.
pub trait Source: Send + Sync {
    /// Returns the number of the run to show now. `None` without a run.
    ///
    /// # Errors
    /// One sentence: a named run that is not there, or a store that cannot be read.
    fn newest(&self) -> Result<Option<u64>, String>;

    /// Returns the trained fields of a run, or those of an earlier run.
    ///
    /// # Errors
    /// One sentence: no such run, or one that cannot be read.
    fn fields(&self, run: u64) -> Result<Vec<FieldSource>, String>;

    /// Returns the objects that a run and its fields name.
    ///
    /// # Errors
    /// As [`Source::fields`].
    fn objects(&self, run: u64) -> Result<BTreeSet<Digest>, String>;

    /// Writes the report of a run, or the page of one of its scenes.
    ///
    /// # Errors
    /// As [`Source::fields`]. An unknown scene.
    fn page(&self, run: u64, scene: Option<&str>, live: &LiveParts) -> Result<LinkedPage, String>;

    /// Makes the splats of a field, unless the store has them, and returns their PLY file. It takes minutes, and ends with the server.
    ///
    /// # Errors
    /// One sentence: a field without a surface, or a lost object.
    fn splats(&self, field: &FieldSource, progress: &Arc<SplatProgress>) -> Result<Arc<[u8]>, String>;

    /// Reads an object. `None` if the store does not have it.
    fn object(&self, digest: &Digest) -> Option<Arc<[u8]>>;

    /// Returns the folder in which running programs leave their events.
    fn event_folder(&self) -> PathBuf;
}

/// A trained field of a run.
#[derive(Debug, Clone)]
pub struct FieldSource {
    /// The node that trained it, as it is shown.
    pub label: String,
    /// The node that trained it.
    pub node: String,
    /// The run of that node.
    pub run: u64,
    /// The field.
    pub weights: Digest,
    /// Its scene.
    pub scene: Digest,
    /// Fields of the retrainings whose uncertainty is shown. Empty if there are none.
    pub members: Vec<Digest>,
    /// Factors for an interval from the spread of their depths. `None` if held-out photos do not give them.
    pub depth_interval: Option<DepthInterval>,
    /// The points that pairs of photos of its scene gave. `None` if the run made none.
    pub cloud: Option<Digest>,
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
