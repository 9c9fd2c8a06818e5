use std::path::PathBuf;

use clap::Args;
use marf_engine::document;
use marf_progress::format::duration;
use marf_run::fit::{FitRequest, FitScores, FitTime, JudgedAt};
use marf_run::{Context, Error};
use marf_schema::train::{Budget, Target};

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
    pub budget: Vec<Budget>,
    /// Total time instead, e.g. `5m`, for decoding, training, scoring and pictures, without folds
    #[arg(long, value_name = "TIME", conflicts_with = "budget")]
    pub within: Option<Budget>,
    /// Stop at this PSNR on validation photos, dB
    #[arg(long, value_name = "DB")]
    pub target: Option<f64>,
    /// Folder for report.html, metrics.json, `<time>s/<name>.png` (renders) and `<time>s/compared/<name>.png` (photo and render)
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
    /// Train again this many times, to map the uncertainty in the report
    #[arg(short = 'b', long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(2..), conflicts_with = "within")]
    pub retrainings: Option<u32>,
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    device: DeviceArg,
}

/// `marf fit DIR`: trains for each time and renders the held-out views.
pub fn fit(args: FitArgs, context: Context) -> Result<(), Error> {
    let context = args.device.context(args.folder.context(context));
    let report = args.out.join(document::REPORT);
    let request = FitRequest {
        dir: args.dir,
        time: args.within.map_or(FitTime::Budgets(args.budget), FitTime::Within),
        target: args.target,
        out: args.out,
        seed: args.seed,
        memory: args.memory,
        fit: args.fit,
        retrainings: args.retrainings,
    };
    let scores = marf_run::fit::fit(&context, &request)?;
    if args.folder.json {
        return print_json(&scores);
    }
    scores
        .iter()
        .for_each(|(name, scores)| print_scores(name, scores));
    eprint_line(&format!("report: {}", report.display()));
    eprint_line(NEXT);
    Ok(())
}

/// What a field is for.
const NEXT: &str = "next: `marf view` shows the field in 3-D, `marf export mesh --out scene.glb` makes a mesh, `marf init --mission folder` writes \
                    a pipeline for photos that change";

fn print_scores(name: &str, scores: &FitScores) {
    let (time, metrics) = (&scores.time, &scores.time.metrics);
    print_line(&format!(
        "{name:>6}  PSNR {:.2} dB  SSIM {:.3}  {} steps in {}, {:.2} M samples/s, {} in all, {} expected",
        metrics.scores.psnr,
        metrics.scores.ssim.unwrap_or(f64::NAN),
        metrics.steps,
        duration(time.seconds.train_seconds),
        scores.samples_per_s / 1e6,
        duration(time.seconds.seconds),
        duration(time.seconds.expected_seconds),
    ));
    print_line(&format!(
        "        {}",
        judged_text(&scores.judged, metrics.scores.views.len())
    ));
    if let Some(target) = &metrics.target {
        print_line(&format!("        {}", target_text(target, metrics.scores.psnr)));
    }
    if let Some(folds) = &time.folds {
        print_line(&format!(
            "        each of the {} photos judged by a field trained without it, {} of {} steps: PSNR {:.2} dB",
            folds.scores.views.len(),
            folds.steps,
            folds.steps_of_whole,
            folds.scores.psnr,
        ));
    }
}

/// Returns how many photos were judged at which size, and where they are next to their renders.
fn judged_text(judged: &JudgedAt, count: usize) -> String {
    let size =
        |of: Option<&[u32; 2]>| of.map_or_else(String::new, |[width, height]| format!("{width} x {height}"));
    let (first, last) = (size(judged.sizes_px.first()), size(judged.sizes_px.last()));
    let sizes = if first == last {
        first
    } else {
        format!("{first} to {last}")
    };
    let reduced = if judged.scale > 1 {
        format!(", reduced by {}", judged.scale)
    } else {
        String::new()
    };
    format!(
        "{count} of {} held-out photos judged at {sizes} pixels{reduced}. Photo and render side by side: {}",
        judged.held_out_photos,
        judged.pictures.display()
    )
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

#[cfg(test)]
mod tests {
    use super::*;
    use marf_schema::train::Forecast;

    #[test]
    fn the_size_at_which_photos_were_judged_is_reported_with_the_pictures() {
        let mut judged = JudgedAt {
            held_out_photos: 12,
            scale: 1,
            sizes_px: [[480, 360]].into(),
            pictures: "fit/60s/compared".into(),
        };
        let pictures = "Photo and render side by side: fit/60s/compared";
        assert_eq!(
            judged_text(&judged, 12),
            format!("12 of 12 held-out photos judged at 480 x 360 pixels. {pictures}")
        );
        judged.sizes_px.insert([96, 128]);
        judged.scale = 4;
        assert_eq!(
            judged_text(&judged, 8),
            format!(
                "8 of 12 held-out photos judged at 96 x 128 to 480 x 360 pixels, reduced by 4. {pictures}"
            )
        );
    }

    #[test]
    fn a_target_is_told_with_its_numbers() {
        let target = |reached_at, forecast| Target {
            psnr: 24.0,
            reached_at,
            validation_psnr: 24.25,
            validation_photos: 9,
            forecast,
        };
        let photos = "24.25 dB on 9 training photos held back";
        assert_eq!(
            target_text(&target(Some(1600), None), 24.0),
            format!("target 24 dB reached after 1600 steps: {photos}, and 24.00 dB on those held out")
        );
        assert_eq!(
            target_text(&target(Some(1600), None), 23.5),
            format!("target 24 dB reached after 1600 steps: {photos}, but 23.50 dB on those held out")
        );
        let forecast = Forecast { at: 800, psnr: 23.04 };
        assert_eq!(
            target_text(&target(None, Some(forecast)), 22.0),
            format!(
                "target 24 dB missed: {photos}, 22.00 dB on those held out (23.0 dB were expected after 800 steps). A longer time or \
                 more photos would help"
            )
        );
    }
}
