//! Table 1 of the MaRF paper (arXiv 2212.01672): PSNR after training times, on photos trained on as there, and on photos held out.

use std::path::PathBuf;

use clap::Args;
use marf_engine::{Cancel, Options};
use marf_run::budget::whole_seconds;
use marf_run::execute::{execute, options};
use marf_run::folder::PhotoFolder;
use marf_run::session::{Session, node_named};
use marf_schema::train::{Metrics, TrainParams};
use marf_stage::Params;
use serde::Serialize;

use crate::options::TrainingOptions;
use crate::output::{Result, decimal, print_json, print_line};

/// The paper's rows: seconds, then dB for Curiosity, Perseverance and Ingenuity. The paper gives neither its photos nor their
/// number nor the machine. The views are those trained on, the peak is each photo's largest value.
const PAPER: [(u32, [f64; 3]); 5] = [
    (10, [23.02, 18.09, 22.07]),
    (60, [26.22, 18.08, 23.00]),
    (300, [31.01, 17.82, 23.86]),
    (600, [34.71, 17.71, 24.25]),
    (900, [36.82, 17.63, 24.24]),
];

/// Arguments of `table1`.
#[derive(Debug, Clone, Args)]
pub struct Table1Args {
    /// A folder with photos, as `marf fit` takes it
    dir: PathBuf,
    /// Training times [default: the paper's]
    #[arg(
        long,
        value_name = "TIMES",
        default_value = "10s,60s,300s,600s,900s",
        value_delimiter = ','
    )]
    budget: Vec<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: TrainingOptions,
}

/// A row of the table.
#[derive(Debug, Clone, Serialize)]
struct Row {
    budget_s: u32,
    train_seconds: f64,
    steps: u64,
    /// On photos trained on, the peak each photo's largest value: the paper's protocol.
    psnr_paper_on_training: Option<f64>,
    /// The same with peak 1.
    psnr_on_training: Option<f64>,
    /// On photos held out, peak 1.
    psnr_held_out: f64,
    ssim_held_out: Option<f64>,
    /// Curiosity, Perseverance and Ingenuity in the paper, where it has this time.
    paper: Option<[f64; 3]>,
}

/// Trains for each time and prints the table, a row as soon as it is there.
///
/// # Errors
/// Returns an error for an invalid time, or if a training fails.
pub fn table1(args: &Table1Args, cancel: &Cancel) -> Result {
    let times = args.budget.iter().map(|text| whole_seconds(text));
    let times = times.collect::<std::result::Result<Vec<u32>, _>>()?;
    if args.json {
        let rows = times.into_iter().map(|budget_s| row(args, budget_s, cancel));
        return print_json(&rows.collect::<Result<Vec<Row>>>()?);
    }
    print_line(HEAD);
    for budget_s in times {
        print_line(&line(&row(args, budget_s, cancel)?));
    }
    print_line(FOOT);
    Ok(())
}

fn row(args: &Table1Args, budget_s: u32, cancel: &Cancel) -> Result<Row> {
    let name = TrainParams::STAGE;
    let mut context = args.options.context(cancel);
    context.sets.push(format!("{name}.budget={budget_s}s"));
    let session = Session::implicit(
        &context,
        &PhotoFolder::new(&args.dir)?.training("table1"),
        "table1",
        &args.dir,
    )?;
    let options = Options {
        to: vec![name.to_owned()],
        ..options(&session)
    };
    let record = execute(&session, &options)?.done()?;
    let node = node_named(&record, name)?;
    let metrics: Metrics = session.document(node)?;
    let made = node.key.and_then(|key| session.store.record(&key).ok().flatten());
    let parts_s = made.map(|record| record.metadata.parts_s).unwrap_or_default();
    let seen = metrics.on_training.as_ref();
    let paper = PAPER.iter().find(|(seconds, _)| *seconds == budget_s);
    Ok(Row {
        budget_s,
        train_seconds: parts_s.get("training").copied().unwrap_or_default(),
        steps: metrics.steps,
        psnr_paper_on_training: seen.and_then(|seen| seen.psnr_paper),
        psnr_on_training: seen.map(|seen| seen.psnr),
        psnr_held_out: metrics.scores.psnr,
        ssim_held_out: metrics.scores.ssim,
        paper: paper.map(|(_, psnr)| *psnr),
    })
}

const HEAD: &str = "\
           trained on                held out          the paper (on photos trained on)
    time   paper's dB   PSNR dB      PSNR dB   SSIM    Curiosity  Perseverance  Ingenuity      steps";
const FOOT: &str = "\
The paper names neither its photos nor its machine. Its numbers are of views trained on, with each photo's largest value as the peak.";

fn line(row: &Row) -> String {
    let [curiosity, perseverance, ingenuity] =
        [0, 1, 2].map(|column| decimal(row.paper.map(|paper| paper[column]), 2));
    format!(
        "{:>7}s {:>12} {:>9} {:>12} {:>6} {:>12} {:>13} {:>10} {:>10}",
        row.budget_s,
        decimal(row.psnr_paper_on_training, 2),
        decimal(row.psnr_on_training, 2),
        decimal(Some(row.psnr_held_out), 2),
        decimal(row.ssim_held_out, 3),
        curiosity,
        perseverance,
        ingenuity,
        row.steps
    )
}
