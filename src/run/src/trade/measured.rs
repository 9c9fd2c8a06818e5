//! Runs a point and takes its figures.

use marf_cache::{Digest, digest_of};
use marf_engine::{Options, RunRecord};
use marf_report::trade::{Point, PointRun};
use marf_schema::calibrate;
use marf_schema::output::WEIGHTS;
use marf_schema::train::{BEFORE_STOP, Metrics};
use marf_stage::Document;

use super::base::Base;
use crate::error::Error;
use crate::execute::{execute, options};
use crate::session::{Session, node_named};

/// Trains a point with seeds from 0 on, or finds the trained results. A point that cannot be trained stores its error.
///
/// # Errors
/// A store that cannot be used, and the wish to stop.
pub fn measure(base: &Base, point: &mut Point, seeds: u64) -> Result<(), Error> {
    let judged = base.judged_as_first(point);
    for seed in 0..seeds {
        let seed_set = format!("{}.seed={seed}", base.train);
        let sets = [base.sets.as_slice(), point.sets.as_slice(), &judged, &[seed_set]].concat();
        let session = match base.open(&sets) {
            Ok(session) => session,
            Err(Error::Usage(diagnostic)) => {
                point.fault = Some(diagnostic.message);
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        let options = Options {
            to: vec![base.train.clone()],
            ..options(&session)
        };
        forget_peak();
        match execute(&session, &options)?.done() {
            Ok(record) => point.runs.push(figures(&session, &record, base, seed)?),
            Err(Error::Failed(diagnostic)) => {
                let cause = diagnostic
                    .cause
                    .map_or_else(String::new, |cause| format!(": {cause}"));
                point.fault = Some(format!("{}{cause}", diagnostic.message));
                return Ok(());
            }
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Lets the system measure the largest memory from here on, where it can: else it is that of all points so far.
fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

fn figures(session: &Session, record: &RunRecord, base: &Base, seed: u64) -> Result<PointRun, Error> {
    let train = node_named(record, &base.train)?;
    let metrics: Metrics = session.document(train)?;
    base.first.borrow_mut().get_or_insert_with(|| metrics.clone());
    let calibrated = base
        .calibrate
        .as_ref()
        .map(|name| node_named(record, name))
        .transpose()?;
    let placed: Option<calibrate::Metrics> = calibrated
        .filter(|node| node.outputs.contains_key(calibrate::Metrics::OUTPUT))
        .map(|node| session.document(node))
        .transpose()?;
    let totals = placed.map(|metrics| metrics.totals);
    let calibrate_s = calibrated.map_or(0.0, |node| node.seconds);
    let made = session.metadata(train).unwrap_or_default();
    let before_s = made.parts_s.get(BEFORE_STOP).copied().unwrap_or_default();
    Ok(PointRun {
        seed,
        judged_by: Some(judged_by(&metrics)),
        judged_scale: metrics.judged_scale.unwrap_or(metrics.scale),
        psnr: metrics.scores.psnr,
        ssim: metrics.scores.ssim,
        seconds: calibrate_s + before_s + train.seconds,
        calibrate_s,
        train_s: made.parts_s.get("training").copied().unwrap_or(train.seconds),
        placed: totals.as_ref().map_or(0, |totals| totals.registered as u64),
        error_px: totals.and_then(|totals| totals.error_px),
        steps: metrics.steps,
        parameters: metrics.field.parameters,
        bytes: train.outputs.get(WEIGHTS).map_or(0, |weights| weights.bytes),
        peak_mb: made.peak_mb,
    })
}

/// Returns a digest of the photos that judge a training.
fn judged_by(metrics: &Metrics) -> Digest {
    let ids: Vec<String> = metrics.scores.views.iter().map(|view| view.id.clone()).collect();
    digest_of(&ids)
}
