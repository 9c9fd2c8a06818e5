//! Makes depths, points and maps of a folder's photos, without a field.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use marf_calibrate::import::names_cameras;
use marf_config::scenes::scene_of;
use marf_engine::{NodeRun, Options, RunRecord};
use marf_scene::{Cahvor, PhotoFacts};
use marf_schema::calibrate::{self, CalibrateParams};
use marf_schema::depth::{DepthParams, Metrics};
use marf_schema::output::{POINTS, SURFACE_MAPS};
use marf_stage::{COMPANIONS, Document, Params};
use nalgebra::Vector3;

use crate::context::Context;
use crate::depth_score::{self, DepthScore, Products, calibrate_of};
use crate::error::Error;
use crate::execute::{Execution, execute, options};
use crate::folder::{self, PhotoFolder};
use crate::scenes::{self, Selection};
use crate::session::{Session, digest, node_named};
use crate::{outputs, photos};

/// A folder whose depths are wanted.
#[derive(Debug, Clone)]
pub struct DepthRequest {
    /// The folder, or a transforms.json.
    pub dir: PathBuf,
    /// Folder to write.
    pub out: PathBuf,
    /// Where cameras come from, as pipeline.toml names it. With `auto`, labels take the place of a structure from motion that places too few.
    pub method: String,
    /// Folder with XYZ, RNG or DSP products of the photos, to score the depths against.
    pub against: Option<PathBuf>,
}

/// The depths of a folder's photos.
#[derive(Debug, Clone)]
pub struct DepthResult {
    /// Why the cameras are those of the labels although the method is `auto`.
    pub why_labels: Option<String>,
    /// One for all photos. With `why_labels`, one for each stop of the rover.
    pub scenes: Vec<SceneDepth>,
    /// How far they are from what other programs measured.
    pub score: Option<DepthScore>,
}

/// The depths of photos in one frame.
#[derive(Debug, Clone)]
pub struct SceneDepth {
    /// Name of the stop, if photos are of several.
    pub name: Option<String>,
    /// How well the cameras fit.
    pub cameras: calibrate::Metrics,
    /// How much of the photos has a depth.
    pub metrics: Metrics,
    /// Seconds of the stage. Those of the run that computed it.
    pub seconds: f64,
    /// The folder with its files.
    pub folder: PathBuf,
    /// The files, pictures of photos aside.
    pub written: Vec<PathBuf>,
}

/// Writes depths, their standard deviations and classes as a picture a photo, a cloud of points, and maps where the scene has metres and an
/// up direction.
///
/// # Errors
/// A folder that cannot be read or written, photos whose cameras are not found.
pub fn depth(context: &Context, request: &DepthRequest) -> Result<DepthResult, Error> {
    let photos = PhotoFolder::new(&request.dir)?;
    let products = request.against.as_deref().map(Products::new).transpose()?;
    let session = |text: String| {
        let text = format!("{text}[node.depth]\ninput = \"calibrate\"\n");
        Session::implicit(context, &text, "depth", &request.dir)
    };
    let found = session(photos.calibration("depth", &request.method))?;
    let why_labels = why_labels(&found)?;
    let found = match &why_labels {
        Some(_) => scenes::found(session(photos.stops("depth"))?, &Selection::default())
            .map_err(folder::for_folder)?,
        None => found,
    };
    let record = run(&found)?;
    let score = products.map(|products| depth_score::score(&found, &record, &products));
    Ok(DepthResult {
        scenes: write(&found, &record, &request.out)?,
        score: score.transpose()?,
        why_labels,
    })
}

/// Returns why the cameras of labels are used: structure from motion places less than half of the photos that have a twin, or finds no scale.
/// `None` if it is not asked for, or if it does better.
fn why_labels(session: &Session) -> Result<Option<String>, Error> {
    if session.tree["node"][CalibrateParams::STAGE]["method"] != "auto" {
        return Ok(None);
    }
    let options = Options {
        to: vec![CalibrateParams::STAGE.to_owned()],
        ..options(session)
    };
    let Execution { record, failure } = execute(session, &options)?;
    let no_labels = |failure: Option<Error>| failure.map_or(Ok(None), |error| Err(folder::for_folder(error)));
    let Some(extract) = record.node("extract").filter(|node| node.state.is_good()) else {
        return no_labels(failure);
    };
    let is_import = match extract.outputs.get(COMPANIONS) {
        Some(_) => names_cameras(&session.output(extract, COMPANIONS)?),
        None => false,
    };
    let all = photos::lines(&session.store, &record, "extract")?;
    let twins = twins(all.iter().map(|line| &line.facts));
    if is_import || twins == 0 || matches!(failure, Some(Error::Interrupted)) {
        return no_labels(failure);
    }
    let reason = match &failure {
        Some(error) => error.message().to_owned(),
        None => {
            let node = node_named(&record, CalibrateParams::STAGE)?;
            let found: calibrate::Metrics = session.document(node)?;
            match too_few(&found, twins) {
                Some(reason) => reason,
                None => return Ok(None),
            }
        }
    };
    Ok(Some(format!(
        "{reason}, so the {twins} photos of stereo pairs have the cameras of their labels"
    )))
}

/// Returns what structure from motion lacks, if it places less than half of the twins or has no scale.
fn too_few(found: &calibrate::Metrics, twins: usize) -> Option<String> {
    let calibrate::Totals {
        registered, photos, ..
    } = found.totals;
    let placed = format!("structure from motion placed {registered} of {photos} photos");
    if found.tie.is_none() {
        return Some(format!("{placed} without a scale"));
    }
    (2 * registered < twins).then_some(placed)
}

/// Eyes of one mast are so far apart, metres, and side by side: least cosine between baseline and rows.
const RIG_M: RangeInclusive<f64> = 0.1..=1.0;
const SIDE_BY_SIDE: f64 = 0.9;

/// Returns how many photos have one of the other eye, taken at the same stop.
fn twins<'a>(photos: impl Iterator<Item = &'a PhotoFacts>) -> usize {
    let mut stops: BTreeMap<&[i64], Vec<&Cahvor>> = BTreeMap::new();
    for prior in photos.filter_map(|facts| facts.prior.as_ref()) {
        let counter = &prior.motion_counter;
        let stop = &counter[..counter.len().min(2)];
        stops.entry(stop).or_default().push(&prior.model);
    }
    let has_twin = |stop: &Vec<&Cahvor>, own: &Cahvor| stop.iter().any(|other| are_eyes(own, other));
    stops
        .values()
        .map(|stop| stop.iter().filter(|own| has_twin(stop, own)).count())
        .sum()
}

fn are_eyes(one: &Cahvor, other: &Cahvor) -> bool {
    let [axis, across, from, to] = [one.a, one.h, one.c, other.c].map(Vector3::<f64>::from);
    let row = (across - axis * across.dot(&axis)).normalize();
    let between = to - from;
    RIG_M.contains(&between.norm()) && row.dot(&between).abs() >= SIDE_BY_SIDE * between.norm()
}

/// Runs a session. A scene that fails is a warning if another has depths.
fn run(session: &Session) -> Result<RunRecord, Error> {
    let Execution { record, failure } = execute(session, &options(session))?;
    if let Some(error) = failure {
        if done(&record).next().is_none() || matches!(error, Error::Interrupted) {
            return Err(folder::for_folder(error));
        }
        session.context.warn(error.message().to_owned());
    }
    Ok(record)
}

/// Returns the nodes with depths.
fn done(record: &RunRecord) -> impl Iterator<Item = &NodeRun> {
    let of_stage = record
        .nodes
        .iter()
        .filter(|node| node.stage == DepthParams::STAGE);
    of_stage.filter(|node| node.outputs.contains_key(Metrics::OUTPUT))
}

/// Writes the depths of all scenes.
fn write(session: &Session, record: &RunRecord, out: &Path) -> Result<Vec<SceneDepth>, Error> {
    let is_one = session.scenes.len() < 2;
    done(record)
        .map(|node| {
            let name = scene_of(&node.name).filter(|_| !is_one);
            write_scene(session, record, node, name, out)
        })
        .collect()
}

fn write_scene(
    session: &Session,
    record: &RunRecord,
    node: &NodeRun,
    name: Option<&str>,
    out: &Path,
) -> Result<SceneDepth, Error> {
    let folder = name.map_or_else(|| out.to_owned(), |name| out.join(name));
    let mut written = Vec::new();
    for output in node.outputs.keys() {
        let path = folder.join(file_name(output));
        outputs::one(&session.store, record, &digest(node, output)?, &path)?;
        if !is_of_photo(output) {
            written.push(path);
        }
    }
    Ok(SceneDepth {
        name: name.map(str::to_owned),
        cameras: session.document(calibrate_of(record, node)?)?,
        metrics: session.document(node)?,
        seconds: seconds(session, node),
        folder,
        written,
    })
}

/// Returns the file that an output becomes.
fn file_name(name: &str) -> &str {
    if name == Metrics::OUTPUT {
        "depth.json"
    } else {
        name
    }
}

fn is_of_photo(name: &str) -> bool {
    name != Metrics::OUTPUT && name != POINTS && !name.starts_with(SURFACE_MAPS)
}

fn seconds(session: &Session, node: &NodeRun) -> f64 {
    session.metadata(node).map_or(node.seconds, |made| made.seconds)
}

#[cfg(test)]
mod tests {
    use marf_scene::CameraPrior;

    use super::*;

    /// Looks along x, with rows along y.
    fn photo(counter: &[i64], place: [f64; 3]) -> PhotoFacts {
        let model = Cahvor {
            c: place,
            a: [1.0, 0.0, 0.0],
            h: [300.0, 1000.0, 0.0],
            v: [200.0, 0.0, 1000.0],
            o: None,
            r: None,
            e: None,
        };
        PhotoFacts {
            prior: Some(CameraPrior {
                model,
                frame: "SITE".to_owned(),
                site_from_frame: None,
                motion_counter: counter.to_vec(),
            }),
            ..PhotoFacts::default()
        }
    }

    #[test]
    fn photos_of_both_eyes_at_one_stop_are_twins_and_others_are_not() {
        let mut photos = [
            photo(&[3, 10, 0], [0.0; 3]),
            photo(&[3, 10, 4], [0.0, 0.42, 0.0]),
            // The mast turned, and moved the left eye along its axis.
            photo(&[3, 10, 0], [0.1, 0.0, 0.0]),
            photo(&[3, 12, 0], [0.0; 3]),
            photo(&[4, 12, 0], [0.0, 0.42, 0.0]),
            photo(&[3, 10, 0], [0.0, -5.0, 0.0]),
        ];
        // 0.1 m along the axis and 0.42 m across it are side by side.
        assert_eq!(twins(photos.iter()), 3);
        // A photo whose label has no camera is no twin.
        photos[1].prior = None;
        assert_eq!(twins(photos.iter()), 0);
    }

    #[test]
    fn structure_from_motion_is_enough_with_a_scale_and_half_of_the_twins() {
        let found = |registered: u64, tie: serde_json::Value| -> calibrate::Metrics {
            let totals = serde_json::json!({"photos": 9, "registered": registered, "held_out": 0, "unplaced": 0, "missing": 0,
                                            "points": 7, "error_px": null, "error_working_px": null});
            let metrics = serde_json::json!({"method": "sfm", "totals": totals, "photos": [], "missing": [], "up": null, "tie": tie});
            serde_json::from_value(metrics).unwrap()
        };
        let tie = serde_json::json!({"site": 3, "photos": 4, "median_m": 0.1, "largest_m": 0.2});
        assert_eq!(too_few(&found(4, tie.clone()), 8), None);
        let few = too_few(&found(3, tie), 8).unwrap();
        assert_eq!(few, "structure from motion placed 3 of 9 photos");
        let bare = too_few(&found(9, serde_json::Value::Null), 8).unwrap();
        assert_eq!(bare, "structure from motion placed 9 of 9 photos without a scale");
    }
}
