use std::path::PathBuf;

use clap::Args;
use marf_progress::format::duration;
use marf_run::fit::{FitRequest, FitScores, FitTime};
use marf_run::{Context, Error};
use marf_schema::train::Target;

use super::options::{DeviceArg, FolderArgs};
use super::output::print_json;
use crate::terminal::{eprint_line, print_line};

/// Arguments of `fit`.
#[derive(Debug, Clone, Args)]
pub struct FitArgs {
    /// Folder with photos. Their cameras come from a transforms.json (nerfstudio, instant-ngp, NeRF) or a COLMAP model in it, or from
    /// structure from motion
    pub dir: PathBuf,
    /// Training times, e.g. `10s,60s,5m`, without decoding and scoring
    #[arg(long, value_name = "TIMES", default_value = "60s", value_delimiter = ',')]
    pub budget: Vec<String>,
    /// Total time instead, e.g. `5m`, for decoding, training, scoring and pictures, without folds
    #[arg(long, value_name = "TIME", conflicts_with = "budget")]
    pub within: Option<String>,
    /// Stop at this PSNR on validation photos, dB
    #[arg(long, value_name = "DB")]
    pub target: Option<f64>,
    /// Folder for `<time>s/<name>.png` and metrics.json
    #[arg(long, value_name = "DIR", default_value = "fit")]
    pub out: PathBuf,
    /// Seed of the training
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Memory limit of the training, e.g. `2GB` [default: 4GB]
    #[arg(long, value_name = "SIZE")]
    pub memory: Option<String>,
    /// Size of the field: `scene` (by scene and time) or `fixed` (base configuration of instant-ngp)
    #[arg(long, value_name = "SIZE", value_parser = ["scene", "fixed"], hide_possible_values = true, default_value = "scene")]
    pub fit: String,
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    device: DeviceArg,
}

/// `marf fit DIR`: trains for each time and renders the held-out views.
pub fn fit(args: FitArgs, context: Context) -> Result<(), Error> {
    let context = args.device.context(args.folder.context(context));
    let request = FitRequest {
        dir: args.dir,
        time: args.within.map_or(FitTime::Budgets(args.budget), FitTime::Within),
        target: args.target,
        out: args.out,
        seed: args.seed,
        memory: args.memory,
        fit: args.fit,
    };
    let scores = marf_run::fit::fit(&context, &request)?;
    if args.folder.json {
        return print_json(&scores);
    }
    scores
        .iter()
        .for_each(|(name, scores)| print_scores(name, scores));
    eprint_line(NEXT);
    Ok(())
}

/// What a field is for.
const NEXT: &str = "next: `marf view` shows the field in 3-D, `marf report` writes the report, `marf export mesh --out scene.glb` makes a mesh";

fn print_scores(name: &str, scores: &FitScores) {
    print_line(&format!(
        "{name:>6}  PSNR {:.2} dB  SSIM {:.3}  {} steps in {}, {:.2} M samples/s, {} in all, {} expected",
        scores.psnr,
        scores.ssim.unwrap_or(f64::NAN),
        scores.steps,
        duration(scores.seconds.train_seconds),
        scores.samples_per_s / 1e6,
        duration(scores.seconds.seconds),
        duration(scores.seconds.expected_seconds),
    ));
    if let Some(target) = &scores.target {
        print_line(&format!("        {}", target_text(target, scores.psnr)));
    }
    if let Some(folds) = &scores.folds {
        print_line(&format!(
            "        each of the {} photos judged by a field trained without it, {} of {} steps: PSNR {:.2} dB",
            folds.scores.views.len(),
            folds.steps,
            folds.steps_of_whole,
            folds.scores.psnr,
        ));
    }
}

/// Returns how a target went, in a sentence.
fn target_text(target: &Target, held_out_psnr: f64) -> String {
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
                " ({:.1} dB were expected after {} steps)",
                forecast.psnr, forecast.at
            )
        });
        return format!(
            "target {psnr} dB missed: {validation_psnr:.2} dB on {photos}, {held_out_psnr:.2} dB on those held out{foreseen}. \
             A longer time or more photos would help"
        );
    };
    let verdict = if held_out_psnr >= *psnr { "and" } else { "but" };
    format!(
        "target {psnr} dB reached after {steps} steps: {validation_psnr:.2} dB on {photos}, {verdict} {held_out_psnr:.2} dB on those \
         held out"
    )
}
