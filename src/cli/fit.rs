use std::path::Path;

use marf_engine::{Cancel, RunRecord};
use serde_json::{Map, Value as Json, json};

use super::args::{FitArgs, Global};
use super::error::CliError;
use super::filter::folder;
use super::run::{execute, options};
use super::session::Session;
use super::{budget, export, files, say_json};

/// `marf fit DIR`: trains for each budget and renders the held-out views. One budget after the other, so that
/// each has the whole machine.
pub fn fit(global: &Global, args: &FitArgs, cancel: &Cancel) -> Result<(), CliError> {
    let budgets = args
        .budget
        .iter()
        .map(|text| budget::seconds(text))
        .collect::<Result<Vec<_>, _>>()?;
    let mut all = Map::new();
    for seconds in budgets {
        let session = Session::implicit(&pipeline(args, seconds), global)?;
        let (record, ended) = execute(&session, &options(global, &session.name), global, cancel)?;
        ended?;
        let metrics = write(&session, &record, &args.out.join(format!("{seconds}s")))?;
        all.insert(format!("{seconds}s"), metrics);
    }
    let text = serde_json::to_vec_pretty(&all).map_err(|error| CliError::failed(error.to_string()))?;
    files::write(&args.out.join("metrics.json"), &text)?;
    if global.json {
        return say_json(&all);
    }
    for (name, metrics) in &all {
        let number = |key: &str| metrics[key].as_f64().unwrap_or(f64::NAN);
        crate::say(&format!(
            "{name:>6}  PSNR {:.2} dB  SSIM {:.3}  {} steps, {:.2} M samples/s, {:.1} s",
            number("psnr"),
            number("ssim"),
            metrics["steps"],
            number("samples_per_s") / 1e6,
            number("seconds"),
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

/// Writes the held-out renders and the model; returns the metrics with the clock beside them.
fn write(session: &Session, record: &RunRecord, out: &Path) -> Result<Json, CliError> {
    let node = record.nodes.iter().find(|node| node.name == "train");
    let node = node.ok_or_else(|| CliError::failed("nothing was trained"))?;
    for (name, output) in &node.outputs {
        if let Some(file) = name.strip_prefix("heldout/") {
            export::one(session, &output.digest, &out.join(file))?;
        }
    }
    let output = node
        .outputs
        .get("metrics")
        .ok_or_else(|| CliError::failed("train gave no `metrics`"))?;
    let metrics: Json = serde_json::from_slice(&session.store.get(&output.digest)?)
        .map_err(|error| CliError::failed(format!("metrics: {error}")))?;
    let made = node.key.and_then(|key| session.store.record(&key).ok().flatten());
    let peak_mb = made.map_or(0, |record| record.metadata.peak_mb);
    // The time of the node less that of finding the pace: decoding, training and rendering the held-out views.
    let pace = record
        .nodes
        .iter()
        .filter(|child| child.parent.as_deref() == Some(node.name.as_str()));
    let seconds = node.seconds - pace.map(|child| child.seconds).sum::<f64>();
    let rate = |key: &str| metrics[key].as_f64().map(|count| count / seconds.max(1e-9));
    Ok(json!({
        "psnr": metrics["psnr"],
        "psnr_paper": metrics["psnr_paper"],
        "ssim": metrics["ssim"],
        "steps": metrics["steps"],
        "rays_per_s": rate("rays"),
        "samples_per_s": rate("samples"),
        "seconds": seconds,
        "peak_mb": peak_mb,
        "views": metrics["views"],
    }))
}
