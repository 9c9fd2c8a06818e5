use std::collections::BTreeMap;
use std::path::Path;

use marf_engine::{Cancel, RunRecord};
use marf_schema::output;
use marf_schema::scores::PhotoScores;
use marf_schema::train::{Metrics, TrainParams};
use marf_stage::Params;
use serde::Serialize;

use super::args::{FitArgs, Global};
use super::error::CliError;
use super::filter::folder;
use super::output::print_json;
use super::run::{execute, options};
use super::session::{Session, node_named};
use super::{budget, export, files};
use crate::terminal::print_line;

/// What metrics.json holds of one budget.
#[derive(Debug, Serialize)]
struct Fitted {
    psnr: f64,
    psnr_paper: Option<f64>,
    ssim: Option<f64>,
    steps: u64,
    rays_per_s: f64,
    samples_per_s: f64,
    /// Seconds of decoding, training and rendering the held-out views.
    seconds: f64,
    peak_mb: u64,
    views: Vec<PhotoScores>,
}

/// `marf fit DIR`: trains for each budget and renders the held-out views. One budget after the other, so that
/// each has the whole machine.
pub fn fit(global: &Global, args: &FitArgs, cancel: &Cancel) -> Result<(), CliError> {
    let budgets = args
        .budget
        .iter()
        .map(|text| budget::whole_seconds(text))
        .collect::<Result<Vec<_>, _>>()?;
    let mut all = BTreeMap::new();
    for seconds in budgets {
        let session = Session::implicit(&pipeline(args, seconds), global, cancel)?;
        let (record, ended) = execute(&session, &options(global, &session.name), global, cancel)?;
        ended?;
        let fitted = write(&session, &record, &args.out.join(format!("{seconds}s")))?;
        all.insert(format!("{seconds}s"), fitted);
    }
    // Through a value: keys in the order of the alphabet, as metrics.json has always had them.
    let json = serde_json::to_value(&all).map_err(|error| CliError::failed(error.to_string()))?;
    let text = serde_json::to_vec_pretty(&json).map_err(|error| CliError::failed(error.to_string()))?;
    files::write(&args.out.join("metrics.json"), &text)?;
    if global.json {
        return print_json(&json);
    }
    for (name, fitted) in &all {
        print_line(&format!(
            "{name:>6}  PSNR {:.2} dB  SSIM {:.3}  {} steps, {:.2} M samples/s, {:.1} s",
            fitted.psnr,
            fitted.ssim.unwrap_or(f64::NAN),
            fitted.steps,
            fitted.samples_per_s / 1e6,
            fitted.seconds,
        ));
    }
    Ok(())
}

fn pipeline(args: &FitArgs, seconds: u32) -> String {
    let memory = args.memory.as_ref().map_or_else(String::new, |size| {
        format!("memory = {}\n", toml::Value::String(size.clone()))
    });
    format!(
        "name = \"fit\"\n{}[node.calibrate]\ninput = \"extract\"\ncameras = \"extract\"\nmethod = \"import\"\n\
         [node.train]\ninput = \"calibrate\"\nbudget = \"{seconds}s\"\nseed = {}\nfit = \"{}\"\n{memory}",
        folder(&args.dir),
        args.seed,
        args.fit.name()
    )
}

/// Writes the held-out renders and returns the metrics with the clock beside them.
fn write(session: &Session, record: &RunRecord, out: &Path) -> Result<Fitted, CliError> {
    let node = node_named(record, TrainParams::STAGE)?;
    for (name, output) in &node.outputs {
        if let Some(file) = name.strip_prefix(output::HELDOUT) {
            export::one(session, record, &output.digest, &out.join(file))?;
        }
    }
    let metrics: Metrics = session.document(node)?;
    let made = node.key.and_then(|key| session.store.record(&key).ok().flatten());
    let peak_mb = made.map_or(0, |record| record.metadata.peak_mb);
    // The node's time less that of its child `pace`.
    let pace = record
        .nodes
        .iter()
        .filter(|child| child.parent.as_deref() == Some(node.name.as_str()));
    let seconds = node.seconds - pace.map(|child| child.seconds).sum::<f64>();
    let rate = |count: u64| count as f64 / seconds.max(1e-9);
    Ok(Fitted {
        psnr: metrics.scores.psnr,
        psnr_paper: metrics.scores.psnr_paper,
        ssim: metrics.scores.ssim,
        steps: metrics.steps,
        rays_per_s: rate(metrics.rays),
        samples_per_s: rate(metrics.samples),
        seconds,
        peak_mb,
        views: metrics.scores.views,
    })
}
