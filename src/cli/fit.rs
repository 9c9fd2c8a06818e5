use std::collections::BTreeMap;
use std::path::Path;

use marf_cache::Digest;
use marf_engine::{Cancel, NodeRun, Outcome, RunRecord, document};
use marf_schema::calibrate::{self, CalibrateParams};
use marf_schema::folds::{self, FoldsParams};
use marf_schema::output;
use marf_schema::scores::PhotoScores;
use marf_schema::train::{Metrics, Target, TrainParams};
use marf_stage::Params;
use serde::Serialize;

use super::args::{FitArgs, Global};
use super::documents::{self, Documents};
use super::error::CliError;
use super::folder;
use super::output::print_json;
use super::run::{Execution, execute_as, options};
use super::session::{Session, node_named};
use super::{budget, export};
use crate::terminal::{eprint_line, print_line};

/// What metrics.json holds of one time.
#[derive(Debug, Clone, Serialize)]
struct Fitted {
    /// Key of the training, by which other runs have it too.
    key: Digest,
    #[serde(flatten)]
    seconds: Seconds,
    #[serde(flatten)]
    metrics: Metrics,
    /// A scene of few photos, judged on all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    folds: Option<folds::Judged>,
}

/// How long a training took when it was made.
#[derive(Debug, Clone, Serialize)]
struct Seconds {
    /// Trials and steps.
    train_seconds: f64,
    /// Renders and scores of the photos that it is judged by.
    judging_seconds: f64,
    /// All, with decoding.
    seconds: f64,
    /// All, as it was foreseen before the first step.
    expected_seconds: f64,
}

/// What `--json` prints of one time.
#[derive(Debug, Serialize)]
struct Timed {
    psnr: f64,
    psnr_paper: Option<f64>,
    ssim: Option<f64>,
    steps: u64,
    rays_per_s: f64,
    samples_per_s: f64,
    #[serde(flatten)]
    seconds: Seconds,
    peak_mb: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    target: Option<Target>,
    views: Vec<PhotoScores>,
    /// A scene of few photos, judged on all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    folds: Option<folds::Judged>,
}

/// `marf fit DIR`: trains for each time and renders the held-out views. One time after the other, so that
/// each has the whole machine.
pub fn fit(global: &Global, args: &FitArgs, cancel: &Cancel) -> Result<(), CliError> {
    let times: Vec<&String> = args
        .within
        .as_ref()
        .map_or(args.budget.iter().collect(), |within| vec![within]);
    let times = times.into_iter().map(|text| budget::whole_seconds(text));
    let (mut fitted, mut timed) = (BTreeMap::new(), BTreeMap::new());
    for seconds in times.collect::<Result<Vec<_>, _>>()? {
        let name = format!("{seconds}s");
        let session = Session::implicit(&pipeline(args, seconds), global, cancel)?;
        let execution = Execution {
            trace: None,
            documents: &|record| document(&session, record, &name, &fitted),
        };
        let options = options(global, &session.name);
        let (record, ended) = execute_as(&session, &options, global, cancel, &execution)?;
        ended?;
        let cameras: calibrate::Metrics = session.document(node_named(&record, CalibrateParams::STAGE)?)?;
        let totals = &cameras.totals;
        eprint_line(&format!(
            "cameras: {}, {} of {} photos placed",
            cameras.method, totals.registered, totals.photos
        ));
        write(&session, &record, &args.out, &name)?;
        timed.insert(name.clone(), timed_of(&session, &record)?);
        fitted.insert(name, fitted_of(&session, &record)?);
    }
    if global.json {
        return print_json(&timed);
    }
    for (name, timed) in &timed {
        print_line(&format!(
            "{name:>6}  PSNR {:.2} dB  SSIM {:.3}  {} steps in {:.1} s, {:.2} M samples/s; {:.1} s in all, {:.0} foreseen",
            timed.psnr,
            timed.ssim.unwrap_or(f64::NAN),
            timed.steps,
            timed.seconds.train_seconds,
            timed.samples_per_s / 1e6,
            timed.seconds.seconds,
            timed.seconds.expected_seconds,
        ));
        if let Some(target) = &timed.target {
            print_line(&format!("        {}", told(target, timed.psnr)));
        }
        if let Some(folds) = &timed.folds {
            print_line(&format!(
                "        each of the {} photos judged by a field trained without it, {} of {} steps: PSNR {:.2} dB",
                folds.scores.views.len(),
                folds.steps,
                folds.steps_of_whole,
                folds.scores.psnr,
            ));
        }
    }
    Ok(())
}

/// Returns how a target went, in a sentence.
fn told(target: &Target, held_out_psnr: f64) -> String {
    let Target {
        psnr,
        reached_at,
        validation_psnr,
        validation_photos,
        forecast,
    } = target;
    let photos = format!("{validation_photos} training photos held back");
    let Some(steps) = reached_at else {
        let foreseen = forecast.map_or_else(String::new, |forecast| {
            format!(
                "; {:.1} dB were foreseen after {} steps",
                forecast.psnr, forecast.at
            )
        });
        return format!(
            "target {psnr} dB missed: {validation_psnr:.2} dB on {photos}, {held_out_psnr:.2} dB on those held out{foreseen}; \
             a longer time or more photos would help"
        );
    };
    let verdict = match held_out_psnr >= *psnr {
        true => "and",
        false => "but",
    };
    format!(
        "target {psnr} dB reached after {steps} steps: {validation_psnr:.2} dB on {photos}, {verdict} {held_out_psnr:.2} dB on those \
         held out"
    )
}

fn pipeline(args: &FitArgs, seconds: u32) -> String {
    let memory = args.memory.as_ref().map_or_else(String::new, |size| {
        format!("memory = {}\n", toml::Value::String(size.clone()))
    });
    let (length, folds) = match args.within {
        Some(_) => ("within", ""),
        None => ("budget", "[node.folds]\ninput = \"calibrate\"\nof = \"train\"\n"),
    };
    let target = args
        .target
        .map_or_else(String::new, |psnr| format!("target_psnr = {psnr:?}\n"));
    format!(
        "{}{length} = \"{seconds}s\"\nseed = {}\nfit = \"{}\"\n{memory}{target}{folds}",
        folder::training("fit", &args.dir),
        args.seed,
        args.fit.name()
    )
}

/// Stores the metrics of this budget and of those before it; nothing of a run that has none.
fn document(
    session: &Session,
    record: &RunRecord,
    budget: &str,
    before: &BTreeMap<String, Fitted>,
) -> Result<Documents, CliError> {
    if record.outcome != Outcome::Done {
        return Ok(Documents::new());
    }
    let mut all = before.clone();
    all.insert(budget.to_owned(), fitted_of(session, record)?);
    let json = serde_json::to_vec_pretty(&all).map_err(|error| CliError::failed(error.to_string()))?;
    Ok(Documents::from([documents::put(
        session,
        document::METRICS,
        &json,
    )?]))
}

/// Writes metrics.json and, into the folder of the budget, the held-out renders.
fn write(session: &Session, record: &RunRecord, out: &Path, budget: &str) -> Result<(), CliError> {
    if let Some(metrics) = record.documents.get(document::METRICS) {
        export::one(session, record, &metrics.digest, &out.join(document::METRICS))?;
    }
    let node = node_named(record, TrainParams::STAGE)?;
    for (name, output) in &node.outputs {
        if let Some(file) = name.strip_prefix(output::HELDOUT) {
            export::one(session, record, &output.digest, &out.join(budget).join(file))?;
        }
    }
    Ok(())
}

fn fitted_of(session: &Session, record: &RunRecord) -> Result<Fitted, CliError> {
    let node = node_named(record, TrainParams::STAGE)?;
    let key = node
        .key
        .ok_or_else(|| CliError::failed("the training has no key"))?;
    let metrics = session.document(node)?;
    Ok(Fitted {
        key,
        seconds: seconds_of(session, node),
        metrics,
        folds: folds_of(session, record)?,
    })
}

/// Returns what folds gave, where the scene is small enough for them.
fn folds_of(session: &Session, record: &RunRecord) -> Result<Option<folds::Judged>, CliError> {
    let node = record.node(FoldsParams::STAGE);
    let metrics = node
        .map(|node| session.document::<folds::Metrics>(node))
        .transpose()?;
    Ok(metrics.and_then(|metrics| metrics.judged))
}

/// Returns the scores of a training with what it took on this machine.
fn timed_of(session: &Session, record: &RunRecord) -> Result<Timed, CliError> {
    let node = node_named(record, TrainParams::STAGE)?;
    let metrics: Metrics = session.document(node)?;
    let made = node.key.and_then(|key| session.store.record(&key).ok().flatten());
    let peak_mb = made.map_or(0, |record| record.metadata.peak_mb);
    let seconds = seconds_of(session, node);
    let rate = |count: u64| count as f64 / seconds.train_seconds.max(1e-9);
    Ok(Timed {
        psnr: metrics.scores.psnr,
        psnr_paper: metrics.scores.psnr_paper,
        ssim: metrics.scores.ssim,
        steps: metrics.steps,
        rays_per_s: rate(metrics.rays),
        samples_per_s: rate(metrics.samples),
        seconds,
        peak_mb,
        target: metrics.target,
        views: metrics.scores.views,
        folds: folds_of(session, record)?,
    })
}

/// Returns how long a training took when it was made; 0 where an earlier version has made it and told no parts.
fn seconds_of(session: &Session, node: &NodeRun) -> Seconds {
    let record = node.key.and_then(|key| session.store.record(&key).ok().flatten());
    let parts = record.map(|record| record.metadata.parts_s).unwrap_or_default();
    let part = |name: &str| parts.get(name).copied().unwrap_or_default();
    Seconds {
        train_seconds: part("training"),
        judging_seconds: part("judging"),
        seconds: node.seconds,
        expected_seconds: part("expected"),
    }
}
