//! Trains a field on the photos of a folder, once for each time.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use marf_cache::{Digest, Store};
use marf_engine::{NodeRun, Outcome, RunRecord, document};
use marf_scene::{Photo, encode_png, picture::side_by_side};
use marf_schema::calibrate::{self, CalibrateParams};
use marf_schema::folds::{self, FoldsParams};
use marf_schema::output;
use marf_schema::train::{Budget, Metrics, TrainParams};
use marf_stage::Params;
use serde::Serialize;

use crate::context::Context;
use crate::documents::{self, Documents};
use crate::error::Error;
use crate::execute::{Extras, execute_with, options};
use crate::folder::{self, PhotoFolder};
use crate::live_report::LiveReport;
use crate::session::{Session, node_named};
use crate::{files, outputs, report};

/// Folder of the pictures of a time that show a photo and its render.
const COMPARED: &str = "compared";

/// A folder to train on.
#[derive(Debug, Clone)]
pub struct FitRequest {
    /// The folder, or a transforms.json.
    pub dir: PathBuf,
    /// How long to train.
    pub time: FitTime,
    /// Stop at this PSNR on training photos that are held back, dB.
    pub target: Option<f64>,
    /// Folder to write.
    pub out: PathBuf,
    /// Seed of the training.
    pub seed: u64,
    /// Memory that the training may take, as pipeline.toml has it.
    pub memory: Option<String>,
    /// What decides how large the field is, as pipeline.toml names it.
    pub fit: String,
    /// Retrainings that map the uncertainty.
    pub retrainings: Option<u32>,
}

/// How long to train.
#[derive(Debug, Clone)]
pub enum FitTime {
    /// Trials and steps, each time on its own.
    Budgets(Vec<Budget>),
    /// The whole wait.
    Within(Budget),
}

/// What metrics.json holds of one time.
#[derive(Debug, Clone, Serialize)]
pub struct TimeMetrics {
    /// Key of the training, by which other runs have it too.
    pub key: Digest,
    /// How long it took.
    #[serde(flatten)]
    pub seconds: Seconds,
    /// The metrics of the training.
    #[serde(flatten)]
    pub metrics: Metrics,
    /// A scene of few photos, judged on all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folds: Option<folds::Judged>,
}

/// How long a training took when it was made.
#[derive(Debug, Clone, Serialize)]
pub struct Seconds {
    /// Trials and steps.
    pub train_seconds: f64,
    /// Renders and scores of the photos that it is judged by.
    pub judging_seconds: f64,
    /// All, with decoding.
    pub seconds: f64,
    /// All, as it was foreseen before the first step.
    pub expected_seconds: f64,
}

/// How photos were judged.
#[derive(Debug, Clone, Serialize)]
pub struct JudgedAt {
    /// Photos held out. Each view has the scores of one that was judged.
    pub held_out_photos: u64,
    /// Whole factor by which photos and renders were shrunk before they were compared.
    pub scale: u32,
    /// Sizes after that, width and height, pixels, in order.
    pub sizes_px: BTreeSet<[u32; 2]>,
    /// Folder with one picture a judged photo: the photo on the left, its render on the right.
    pub pictures: PathBuf,
}

/// Scores of one time, with the time and memory that it took on this machine.
#[derive(Debug, Serialize)]
pub struct FitScores {
    /// What metrics.json holds of it.
    #[serde(flatten)]
    pub time: TimeMetrics,
    /// Rays a second.
    pub rays_per_s: f64,
    /// Samples a second.
    pub samples_per_s: f64,
    /// Largest memory, MB.
    pub peak_mb: u64,
    /// At which size photos were judged, and where they are next to their renders.
    pub judged: JudgedAt,
}

/// Trains for each time and renders the held-out views. The times follow one after the other, so that each has the whole machine.
///
/// # Errors
/// A folder that cannot be read or written, a run that fails.
pub fn fit(context: &Context, request: &FitRequest) -> Result<BTreeMap<String, FitScores>, Error> {
    let times = match &request.time {
        FitTime::Budgets(budgets) => budgets.as_slice(),
        FitTime::Within(within) => std::slice::from_ref(within),
    };
    let photos = PhotoFolder::new(&request.dir)?;
    let (mut fitted, mut scores) = (BTreeMap::new(), BTreeMap::new());
    for time in times {
        let name = time.to_string();
        let session = Session::implicit(context, &pipeline(&photos, request, *time), "fit", &request.dir)?;
        let live = LiveReport::new(&session, &request.out);
        let extras = Extras {
            documents: &|record| documents(&session, record, &name, &fitted),
            listener: &live,
        };
        let execution = execute_with(&session, &options(&session), &extras)?;
        if execution.record.outcome == Outcome::Cancelled {
            live.write_stopped(&execution.record);
        } else if let Some(page) = execution.record.documents.get(document::REPORT) {
            let file = request.out.join(document::REPORT);
            outputs::one(&session.store, &execution.record, &page.digest, &file)?;
        }
        let record = execution.done().map_err(folder::for_folder)?;
        let cameras: calibrate::Metrics = session.document(node_named(&record, CalibrateParams::STAGE)?)?;
        let totals = &cameras.totals;
        context.feedback.note(&format!(
            "cameras: {}, {} of {} photos placed",
            cameras.method, totals.registered, totals.photos
        ));
        write(&session.store, &record, &request.out, &name)?;
        let folder = request.out.join(&name).join(COMPARED);
        let metrics = metrics_of(&session, &record)?;
        scores.insert(name.clone(), scores_of(&session, &record, &metrics, folder)?);
        fitted.insert(name, metrics);
    }
    Ok(scores)
}

fn pipeline(photos: &PhotoFolder, request: &FitRequest, time: Budget) -> String {
    let memory = request.memory.as_ref().map_or_else(String::new, |size| {
        format!("memory = {}\n", toml::Value::String(size.clone()))
    });
    let (length, folds) = match request.time {
        FitTime::Within(_) => ("within", ""),
        FitTime::Budgets(_) => (
            "budget",
            "[node.folds]\ninput = \"calibrate\"\ntraining = \"train\"\n",
        ),
    };
    let target = request
        .target
        .map_or_else(String::new, |psnr| format!("target_psnr = {psnr:?}\n"));
    let bootstrap = request.retrainings.map_or_else(String::new, |count| {
        format!("[node.bootstrap]\ninput = \"calibrate\"\ntraining = \"train\"\nb = {count}\n")
    });
    format!(
        "{}{length} = \"{time}\"\nseed = {}\nfit = \"{}\"\n{memory}{target}{folds}{bootstrap}",
        photos.training("fit"),
        request.seed,
        request.fit
    )
}

/// Stores the report, and the metrics of this budget and of those before it. A run that failed has no metrics.
fn documents(
    session: &Session,
    record: &RunRecord,
    budget: &str,
    before: &BTreeMap<String, TimeMetrics>,
) -> Result<Documents, Error> {
    let mut stored = report::documents(session, record)?;
    if record.outcome != Outcome::Done {
        return Ok(stored);
    }
    let mut all = before.clone();
    all.insert(budget.to_owned(), metrics_of(session, record)?);
    let json = serde_json::to_vec_pretty(&all).map_err(|error| Error::failed(error.to_string()))?;
    let (name, metrics) = documents::put(session, document::METRICS, &json)?;
    stored.insert(name, metrics);
    Ok(stored)
}

/// Writes metrics.json and, into the folder of the budget, the held-out renders.
fn write(store: &Store, record: &RunRecord, out: &Path, budget: &str) -> Result<(), Error> {
    if let Some(metrics) = record.documents.get(document::METRICS) {
        outputs::one(store, record, &metrics.digest, &out.join(document::METRICS))?;
    }
    let node = node_named(record, TrainParams::STAGE)?;
    for (name, output) in &node.outputs {
        if let Some(file) = name.strip_prefix(output::HELDOUT) {
            outputs::one(store, record, &output.digest, &out.join(budget).join(file))?;
        }
    }
    Ok(())
}

fn metrics_of(session: &Session, record: &RunRecord) -> Result<TimeMetrics, Error> {
    let node = node_named(record, TrainParams::STAGE)?;
    let key = node.key.ok_or_else(|| Error::failed("the training has no key"))?;
    let metrics = session.document(node)?;
    Ok(TimeMetrics {
        key,
        seconds: seconds_of(session, node),
        metrics,
        folds: folds_of(session, record)?,
    })
}

/// Returns the scores of the folds, if the scene is small enough for folds.
fn folds_of(session: &Session, record: &RunRecord) -> Result<Option<folds::Judged>, Error> {
    let node = record.node(FoldsParams::STAGE);
    let metrics = node
        .map(|node| session.document::<folds::Metrics>(node))
        .transpose()?;
    Ok(metrics.and_then(|metrics| metrics.judged))
}

/// Writes each judged photo next to its render, and returns the sizes of the photos.
fn write_compared(store: &Store, node: &NodeRun, folder: &Path) -> Result<BTreeSet<[u32; 2]>, Error> {
    let decoded = |name: &str| {
        let output = node.outputs.get(name);
        let output = output.ok_or_else(|| Error::failed(format!("the training has no output `{name}`")))?;
        let photo = Photo::decode(&store.get(&output.digest)?);
        photo.map_err(|error| Error::failed(format!("output `{name}`: {error}")))
    };
    let mut sizes = BTreeSet::new();
    for file in node
        .outputs
        .keys()
        .filter_map(|name| name.strip_prefix(output::HELDOUT))
    {
        let photo = decoded(&format!("{}{file}", output::PHOTO))?.image;
        let render = decoded(&format!("{}{file}", output::HELDOUT))?.image;
        sizes.insert([photo.width, photo.height]);
        let png = encode_png(&side_by_side(&[&photo, &render]));
        let png = png.map_err(|error| Error::failed(format!("{file}: {error}")))?;
        files::write(&folder.join(file), &png)?;
    }
    Ok(sizes)
}

/// Returns the scores of a training with the time and memory that it took on this machine. Photos and renders go into the folder.
fn scores_of(
    session: &Session,
    record: &RunRecord,
    time: &TimeMetrics,
    folder: PathBuf,
) -> Result<FitScores, Error> {
    let node = node_named(record, TrainParams::STAGE)?;
    let metrics = &time.metrics;
    let rate = |count: u64| count as f64 / time.seconds.train_seconds.max(1e-9);
    Ok(FitScores {
        rays_per_s: rate(metrics.rays),
        samples_per_s: rate(metrics.samples),
        peak_mb: session.metadata(node).map_or(0, |made| made.peak_mb),
        judged: JudgedAt {
            held_out_photos: metrics.held_out_photos,
            scale: metrics.judged_scale.unwrap_or(metrics.scale),
            sizes_px: write_compared(&session.store, node, &folder)?,
            pictures: folder,
        },
        time: time.clone(),
    })
}

/// Returns the times of a training when it was computed. Parts are 0 if an earlier version computed it and stored no times of parts.
fn seconds_of(session: &Session, node: &NodeRun) -> Seconds {
    let parts = session.metadata(node).unwrap_or_default().parts_s;
    let part = |name: &str| parts.get(name).copied().unwrap_or_default();
    Seconds {
        train_seconds: part("training"),
        judging_seconds: part("judging"),
        seconds: node.seconds,
        expected_seconds: part("expected"),
    }
}
