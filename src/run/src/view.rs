//! The store as the live page reads it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_engine::{NodeRun, RunRecord, document, run_of};
use marf_model::select::{self, Subject};
use marf_progress::event_folder;
use marf_report::sentence_page;
use marf_schema::bootstrap::Metrics;
use marf_schema::output::{SCENE, WEIGHTS};
use marf_stage::Document;
use marf_view::{DepthInterval, FieldSource, RunContent, Source};
use parking_lot::Mutex;

use crate::choice::subject;
use crate::context::Context;
use crate::error::Error;
use crate::scenes;
use crate::session::bootstraps_of;

/// The store as the page reads it.
pub struct StoreSource {
    store: Store,
    /// What the runs to show are runs of.
    subject: Subject,
    /// The run that the user named.
    run: Option<u64>,
    /// The last run of the store when it was last looked for, and the run to show then.
    newest: Mutex<(Option<u64>, Option<u64>)>,
}

impl StoreSource {
    /// Opens the store of a context; `run` is the run that the user named.
    ///
    /// # Errors
    /// A store that is not there or cannot be opened.
    pub fn open(context: &Context, run: Option<u64>) -> Result<Self, Error> {
        let store = context.existing_store()?;
        Ok(Self {
            subject: subject(context, &store)?,
            store,
            run,
            newest: Mutex::default(),
        })
    }

    /// Returns the run to show: the one that the user named, or the newest in any state.
    fn record(&self) -> Result<Option<RunRecord>, String> {
        if let Some(number) = self.run {
            let run = run_of(&self.store, number).map_err(|error| error.to_string())?;
            return Ok(Some(run));
        }
        // A run that cannot be read is passed over here: `marf log` names it.
        select::newest(&self.store, &self.subject, |_| {}).map_err(|error| error.to_string())
    }

    /// Returns the last run of the same pipeline before a run that has a field.
    fn trained_before(&self, run: &RunRecord) -> Option<RunRecord> {
        let numbers = self.store.run_numbers().ok()?.into_iter().rev();
        let earlier = numbers.filter(|number| *number < run.number);
        let mut runs = earlier.filter_map(|number| run_of(&self.store, number).ok());
        runs.find(|before| {
            before.pipeline == run.pipeline && before.source == run.source && trained(before).next().is_some()
        })
    }

    /// Returns the digest of the report that a run has kept.
    fn report(&self, run: &RunRecord) -> Option<Digest> {
        let digest = run.documents.get(document::REPORT)?.digest;
        self.store.contains(&digest).then_some(digest)
    }

    /// Returns a run as it is shown.
    fn shown(&self, run: &RunRecord) -> Result<RunContent, String> {
        let report = match self.report(run) {
            Some(kept) => text(&self.store.get(&kept).map_err(|error| error.to_string())?)?,
            None => sentence_page(&without_report(run)),
        };
        let (mut objects, mut fields) = (objects(run), self.fields(run));
        if fields.is_empty()
            && let Some(earlier) = self.trained_before(run)
        {
            objects.extend(self::objects(&earlier));
            fields = self.fields(&earlier);
            for field in &mut fields {
                field.node = format!("{} of run {}", field.node, earlier.number);
            }
        }
        Ok(RunContent {
            number: Some(run.number),
            report,
            pages: scenes::pages(run),
            objects,
            fields,
        })
    }

    /// Returns the trained fields of a run with the retrainings of each.
    fn fields(&self, run: &RunRecord) -> Vec<FieldSource> {
        trained(run)
            .filter_map(|node| {
                Some(FieldSource {
                    node: node.name.clone(),
                    weights: node.outputs.get(WEIGHTS)?.digest,
                    scene: node.outputs.get(SCENE)?.digest,
                    members: members(run, node),
                    depth_interval: self.depth_interval(run, node),
                })
            })
            .collect()
    }

    /// Returns what the bootstrap of a training tells of its depths; none where it tells nothing or its metrics are lost.
    fn depth_interval(&self, run: &RunRecord, trained: &NodeRun) -> Option<DepthInterval> {
        let metrics = bootstraps_of(run, &trained.name).find_map(|node| {
            let bytes = self.store.get(&node.outputs.get(Metrics::OUTPUT)?.digest).ok()?;
            Metrics::decode(&bytes).ok()
        });
        let calibration = metrics?.heldout?.depth_calibration?;
        Some(DepthInterval {
            floor: calibration.floor,
            factor: calibration.factor90,
        })
    }
}

impl Source for StoreSource {
    fn newest(&self) -> Option<u64> {
        // Asked several times a second: the runs are read only where there is another one.
        let last = self.store.run_numbers().ok()?.into_iter().next_back();
        let mut newest = self.newest.lock();
        if newest.0 != last {
            *newest = (last, self.record().ok().flatten().map(|run| run.number));
        }
        newest.1
    }

    fn content(&self) -> Result<RunContent, String> {
        let Some(run) = self.record()? else {
            let sentence =
                "No run of this store has ended with a report or a field yet. What runs now is shown here.";
            return Ok(RunContent {
                number: None,
                report: sentence_page(sentence),
                pages: BTreeMap::new(),
                objects: BTreeSet::new(),
                fields: Vec::new(),
            });
        };
        self.shown(&run)
    }

    fn content_of(&self, run: u64) -> Result<RunContent, String> {
        if self.run.is_some_and(|named| named != run) {
            return Err(format!(
                "this page is of run {run}, and another is shown now: load it again"
            ));
        }
        let run = run_of(&self.store, run).map_err(|error| error.to_string())?;
        self.shown(&run)
    }

    fn object(&self, digest: &Digest) -> Option<Arc<[u8]>> {
        self.store.get(digest).ok()
    }

    fn event_folder(&self) -> PathBuf {
        event_folder(&self.store)
    }
}

fn text(bytes: &[u8]) -> Result<String, String> {
    String::from_utf8(bytes.to_vec()).map_err(|error| format!("the report is no text: {error}"))
}

/// Returns the sentence in place of a report: of `marf fit`, `marf calibrate` and runs that were stopped.
fn without_report(run: &RunRecord) -> String {
    format!("Run {} (`{}`) has kept no report.", run.number, run.command)
}

/// Returns what a run names: outputs of its nodes, and documents.
fn objects(run: &RunRecord) -> BTreeSet<Digest> {
    let outputs = run.nodes.iter().flat_map(|node| node.outputs.values());
    outputs
        .chain(run.documents.values())
        .map(|output| output.digest)
        .collect()
}

/// Returns the nodes of a run that have trained a field.
fn trained(run: &RunRecord) -> impl Iterator<Item = &NodeRun> {
    let whole = run.nodes.iter().filter(|node| node.parent.is_none());
    whole.filter(|node| {
        [WEIGHTS, SCENE]
            .iter()
            .all(|output| node.outputs.contains_key(*output))
    })
}

/// Returns the fields that the bootstraps of a training have trained.
fn members(run: &RunRecord, trained: &NodeRun) -> Vec<Digest> {
    let parents: Vec<&str> = bootstraps_of(run, &trained.name)
        .map(|node| node.name.as_str())
        .collect();
    let of_it = |node: &&NodeRun| {
        node.parent
            .as_deref()
            .is_some_and(|parent| parents.contains(&parent))
    };
    let weights = run
        .nodes
        .iter()
        .filter(of_it)
        .filter_map(|node| node.outputs.get(WEIGHTS));
    weights.map(|weights| weights.digest).collect()
}
