use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValue;
use marf_progress::format::number;
use marf_run::calibrate::{CalibrateRequest, CalibrateResult};
use marf_run::{Context, Error};
use marf_scene::Scene;
use marf_schema::calibrate::Up;

use super::options::FolderArgs;
use super::output::print_json;
use crate::terminal::print_lines;

/// Arguments of `calibrate`.
#[derive(Debug, Clone, Args)]
pub struct CalibrateArgs {
    /// Folder with photos, and labels or cameras next to them
    pub dir: PathBuf,
    /// transforms.json to write. Next to it go metrics.json, sparse/0 (COLMAP's model, binary and text), points.ply and undistorted photos
    #[arg(long, value_name = "FILE", default_value = "transforms.json")]
    pub out: PathBuf,
    /// Write undistorted photos as PNG
    #[arg(long)]
    pub undistort: bool,
    /// Source of the cameras
    #[arg(long, value_parser = METHODS.map(|(name, about)| PossibleValue::new(name).help(about)), default_value = METHODS[0].0)]
    pub method: String,
    #[command(flatten)]
    folder: FolderArgs,
}

/// Sources of cameras.
pub(super) const METHODS: [(&str, &str); 4] = [
    ("sfm", "Structure from motion"),
    ("labels", "Camera models of the labels"),
    ("import", "transforms.json or a COLMAP model in the folder"),
    ("auto", "`import` if the folder contains cameras, else `sfm`"),
];

/// Most reasons of photos without a camera that have a line of their own.
const MOST_REASONS: usize = 3;

/// `marf calibrate DIR`: writes transforms.json, and next to it metrics.json, COLMAP's model, the points and undistorted photos.
pub fn calibrate(args: CalibrateArgs, context: Context) -> Result<(), Error> {
    let request = CalibrateRequest {
        dir: args.dir,
        out: args.out,
        undistort: args.undistort,
        method: args.method,
    };
    let result = marf_run::calibrate::calibrate(&args.folder.context(context), &request)?;
    if args.folder.json {
        return print_json(&result.metrics);
    }
    print_lines(table(&result));
    Ok(())
}

fn table(result: &CalibrateResult) -> Vec<String> {
    let CalibrateResult {
        metrics,
        scene,
        written,
    } = result;
    let totals = &metrics.totals;
    let mut rows = vec![
        ("method", scene.method.clone()),
        (
            "registered",
            format!("{} of {} photos", totals.registered, totals.photos),
        ),
    ];
    let mut reasons = reasons(scene);
    let rest: usize = reasons
        .split_off(reasons.len().min(MOST_REASONS))
        .iter()
        .map(|one| one.1)
        .sum();
    rows.extend(
        reasons
            .into_iter()
            .map(|(reason, count)| ("", format!("{count} not: {reason}"))),
    );
    rows.extend((rest > 0).then(|| ("", format!("{rest} not, for other reasons (metrics.json)"))));
    rows.extend(
        totals
            .components
            .map(|components| ("components", components.to_string())),
    );
    rows.push((
        "mean error",
        totals
            .error_px
            .map_or("not measured".to_owned(), |error| format!("{error:.3} px")),
    ));
    rows.push(("points", totals.points.to_string()));
    let scale = scene
        .metres_per_unit
        .map(|metres| format!("one unit is {} m", number(metres)));
    rows.push(("scale", scale.unwrap_or_else(|| "no scale".to_owned())));
    let up = metrics.up.as_ref().map(Up::words);
    rows.push(("up", up.unwrap_or_else(|| "not known".to_owned())));
    for (index, path) in written.iter().enumerate() {
        rows.push((if index == 0 { "wrote" } else { "" }, path.display().to_string()));
    }
    rows.iter()
        .map(|(what, value)| format!("{what:<12} {value}"))
        .collect()
}

/// Why photos have no camera, the commonest reason first.
fn reasons(scene: &Scene) -> Vec<(&str, usize)> {
    let mut counts: std::collections::BTreeMap<&str, usize> = std::collections::BTreeMap::new();
    for one in &scene.unplaced {
        *counts.entry(&one.reason).or_default() += 1;
    }
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    counts
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Photos without a camera by their reasons: all of them are counted, the rarest together.
    #[test]
    fn a_table_counts_every_photo_and_has_the_scale_in_metres() {
        let lost = |reason: &str| marf_scene::Unplaced {
            id: "a".to_owned(),
            reason: reason.to_owned(),
        };
        let reasons = ["w", "x", "x", "x", "y", "y", "z", "z", "v"];
        let totals = json!({"photos": 12, "registered": 3, "held_out": 0, "unplaced": 9, "missing": 0, "points": 7,
                            "error_px": 0.25, "error_working_px": null});
        let metrics =
            json!({"method": "m", "totals": totals, "photos": [], "missing": [], "up": null, "tie": null});
        let result = CalibrateResult {
            metrics: serde_json::from_value(metrics).unwrap(),
            scene: Scene {
                unplaced: reasons.map(lost).to_vec(),
                metres_per_unit: Some(2.5),
                ..Scene::default()
            },
            written: Vec::new(),
        };
        let lines = table(&result);
        for line in [
            "registered   3 of 12 photos",
            "             3 not: x",
            "             2 not, for other reasons (metrics.json)",
            "scale        one unit is 2.5 m",
        ] {
            assert!(lines.iter().any(|found| found == line), "{line}: {lines:#?}");
        }
    }
}
