//! The store as the live page reads it.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;

use marf_cache::{Digest, Store};
use marf_engine::{Event, Listener, NodeRun, RunRecord, run_of};
use marf_model::select::{self, Subject};
use marf_progress::event_folder;
use marf_report::{LinkedPage, LiveParts};
use marf_schema::bootstrap::Metrics;
use marf_schema::depth::DepthParams;
use marf_schema::output::{POINTS, SCENE, WEIGHTS};
use marf_stage::{Document, Params};
use marf_view::{DepthInterval, FieldSource, Source, SplatProgress};
use parking_lot::Mutex;

use crate::choice::subject;
use crate::context::{Context, Feedback, RunFeedback};
use crate::error::Error;
use crate::export::splats;
use crate::report;
use crate::session::bootstraps_of;

/// The store as the page reads it.
pub struct StoreSource {
    /// What splats are made with.
    context: Context,
    store: Store,
    /// The subject of the runs to show.
    subject: Subject,
    /// The run that the user named.
    run: Option<u64>,
    /// The last run of the store when it was last looked for, and the run to show then.
    newest: Mutex<(Option<u64>, Option<u64>)>,
}

impl StoreSource {
    /// Opens the store of a context. `run` is the run that the user named.
    ///
    /// # Errors
    /// A store that is not there or cannot be opened.
    pub fn open(context: &Context, run: Option<u64>) -> Result<Self, Error> {
        let store = context.existing_store()?;
        Ok(Self {
            subject: subject(context, &store)?,
            context: context.clone(),
            store,
            run,
            newest: Mutex::default(),
        })
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

    /// Returns the run of a number, which an open page may still show.
    fn shown(&self, number: u64) -> Result<RunRecord, String> {
        if self.run.is_some_and(|named| named != number) {
            return Err(format!(
                "this page is of run {number}, and another is shown now: load it again"
            ));
        }
        run_of(&self.store, number).map_err(|error| error.to_string())
    }

    /// Returns the trained fields of a run with the retrainings of each, the last first, so that a training comes before its draft.
    fn fields_of(&self, run: &RunRecord) -> Vec<FieldSource> {
        trained(run)
            .rev()
            .filter_map(|node| {
                Some(FieldSource {
                    label: node.name.clone(),
                    node: node.name.clone(),
                    run: run.number,
                    weights: node.outputs.get(WEIGHTS)?.digest,
                    scene: node.outputs.get(SCENE)?.digest,
                    members: members(run, node),
                    depth_interval: self.depth_interval(run, node),
                    cloud: cloud(run, node),
                })
            })
            .collect()
    }

    /// Returns the depth interval from the bootstrap of a training. None without a calibration, or if its metrics are lost.
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
    fn newest(&self) -> Result<Option<u64>, String> {
        if self.run.is_some() {
            return Ok(self.run);
        }
        // Asked several times a second: the runs are read only where there is another one.
        let last = self.store.run_numbers().map_err(|error| error.to_string())?;
        let last = last.into_iter().next_back();
        let mut newest = self.newest.lock();
        if newest.0 != last {
            // A run that cannot be read is passed over here: `marf log` names it.
            let run =
                select::newest(&self.store, &self.subject, |_| {}).map_err(|error| error.to_string())?;
            *newest = (last, run.map(|run| run.number));
        }
        Ok(newest.1)
    }

    fn fields(&self, run: u64) -> Result<Vec<FieldSource>, String> {
        let run = self.shown(run)?;
        let mut fields = self.fields_of(&run);
        if fields.is_empty()
            && let Some(earlier) = self.trained_before(&run)
        {
            fields = self.fields_of(&earlier);
            for field in &mut fields {
                field.label = format!("{} of run {}", field.node, earlier.number);
            }
        }
        Ok(fields)
    }

    fn objects(&self, run: u64) -> Result<BTreeSet<Digest>, String> {
        let run = self.shown(run)?;
        let mut objects: BTreeSet<Digest> = run.objects().collect();
        if trained(&run).next().is_none() {
            objects.extend(self.trained_before(&run).iter().flat_map(RunRecord::objects));
        }
        Ok(objects)
    }

    fn page(&self, run: u64, scene: Option<&str>, live: &LiveParts) -> Result<LinkedPage, String> {
        let run = self.shown(run)?;
        report::linked(&self.store, &run, scene, live).map_err(|error| error.message().to_owned())
    }

    fn splats(&self, field: &FieldSource, progress: &Arc<SplatProgress>) -> Result<Arc<[u8]>, String> {
        let context = Context {
            feedback: Arc::new(SplatFeedback {
                of: Arc::clone(&self.context.feedback),
                progress: Arc::clone(progress),
            }),
            ..self.context.clone()
        };
        splats(&context, field.run, &field.node).map_err(|error| error.message().to_owned())
    }

    fn object(&self, digest: &Digest) -> Option<Arc<[u8]>> {
        self.store.get(digest).ok()
    }

    fn event_folder(&self) -> PathBuf {
        event_folder(&self.store)
    }
}

/// Passes on what happens while splats are made, and keeps how far they are.
struct SplatFeedback {
    of: Arc<dyn Feedback>,
    progress: Arc<SplatProgress>,
}

impl Feedback for SplatFeedback {
    fn warn(&self, message: &str) {
        self.of.warn(message);
    }

    fn note(&self, line: &str) {
        self.of.note(line);
    }

    fn follow(&self, _run: &str) -> Box<dyn RunFeedback> {
        Box::new(SplatListener(Arc::clone(&self.progress)))
    }

    /// The page that asks shows their progress itself, and would take them for a run of the user.
    fn is_public(&self) -> bool {
        false
    }
}

/// Keeps the last progress of the node that makes splats.
struct SplatListener(Arc<SplatProgress>);

impl RunFeedback for SplatListener {}

impl Listener for SplatListener {
    fn on_event(&self, event: &Event) {
        if let Event::Progress {
            done, total, note, ..
        } = event
        {
            self.0.at(*done, *total, note);
        }
    }
}

/// Returns the nodes of a run that have trained a field.
fn trained(run: &RunRecord) -> impl DoubleEndedIterator<Item = &NodeRun> {
    let whole = run.nodes.iter().filter(|node| node.parent.is_none());
    whole.filter(|node| {
        [WEIGHTS, SCENE]
            .iter()
            .all(|output| node.outputs.contains_key(*output))
    })
}

/// Returns the points that pairs of photos of a training's scene gave.
fn cloud(run: &RunRecord, trained: &NodeRun) -> Option<Digest> {
    let scene = trained.inputs.get(SCENE)?;
    let mut depths = run.nodes.iter().filter(|node| node.stage == DepthParams::STAGE);
    let node = depths.find(|node| node.inputs.get(SCENE) == Some(scene))?;
    Some(node.outputs.get(POINTS)?.digest)
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
