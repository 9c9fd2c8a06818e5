use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValue;
use marf_progress::format::{count, duration, number};
use marf_run::depth::{DepthRequest, DepthResult, SceneDepth};
use marf_run::depth_score::DepthScore;
use marf_run::{Context, Error};
use marf_schema::depth::{Agreement, Metrics};

use super::calibrate::METHODS;
use super::options::FolderArgs;
use super::output::print_json;
use crate::terminal::print_lines;

/// Arguments of `depth`.
#[derive(Debug, Clone, Args)]
pub struct DepthArgs {
    /// Folder with photos, and labels or cameras next to them
    pub dir: PathBuf,
    /// Folder to write: depth.json, points.ply, map/ (GeoTIFF and PNG), and for each photo a picture in depth/, inverse-depth/, sigma/,
    /// normal/, class/ and depth-preview/
    #[arg(long, value_name = "DIR", default_value = "depth")]
    pub out: PathBuf,
    /// Source of the cameras. With `auto`, labels take the place of a structure from motion that places less than half of the stereo pairs or finds no scale
    #[arg(long, value_parser = METHODS.map(|(name, about)| PossibleValue::new(name).help(about)), default_value = "auto")]
    pub method: String,
    /// Compare the depths with the XYZ, RNG and DSP products in this folder, which JPL's programs made of the same photos. `--json` then prints the comparison
    #[arg(long, value_name = "PRODUCTS")]
    pub against: Option<PathBuf>,
    #[command(flatten)]
    folder: FolderArgs,
}

/// `marf depth DIR`: writes depths, points and maps of the photos, without a field.
pub fn depth(args: DepthArgs, context: Context) -> Result<(), Error> {
    let request = DepthRequest {
        dir: args.dir,
        out: args.out,
        method: args.method,
        against: args.against,
    };
    let result = marf_run::depth::depth(&args.folder.context(context), &request)?;
    if args.folder.json {
        return print_result(&result);
    }
    print_lines(lines(&result));
    print_lines(result.score.iter().flat_map(score_lines).collect::<Vec<_>>());
    Ok(())
}

/// Prints the comparison if there is one, else the metrics, by name of their stop if there are several.
fn print_result(result: &DepthResult) -> Result<(), Error> {
    if let Some(score) = &result.score {
        return print_json(score);
    }
    if let [scene] = result.scenes.as_slice() {
        return print_json(&scene.metrics);
    }
    let named = result
        .scenes
        .iter()
        .filter_map(|scene| Some((scene.name.as_deref()?, &scene.metrics)));
    print_json(&named.collect::<BTreeMap<_, _>>())
}

fn lines(result: &DepthResult) -> Vec<String> {
    let cameras = result
        .why_labels
        .iter()
        .map(|why| format!("{:<12} {why}", "cameras"));
    if let [scene] = result.scenes.as_slice() {
        return cameras.chain(table(scene)).collect();
    }
    cameras.chain(result.scenes.iter().map(summary)).collect()
}

fn score_lines(score: &DepthScore) -> Vec<String> {
    let line = |what: &str, value: String| format!("{what:<12} {value}");
    let compared = score
        .products
        .iter()
        .filter(|product| product.agreement.is_some());
    let mut lines = vec![line(
        "against",
        format!(
            "{} of {} compared",
            compared.count(),
            count(score.products.len(), "product")
        ),
    )];
    lines.extend(score.products.iter().map(|product| {
        let found = product
            .agreement
            .as_ref()
            .map_or_else(|| product.reason.clone(), agreement);
        line("", format!("{}: {found}", product.file))
    }));
    lines.push(line("in all", agreement(&score.all)));
    lines.extend(score.octaves.iter().map(|octave| {
        let range = format!("{} to {} m", number(octave.from_m), number(octave.to_m));
        line(&range, agreement(&octave.agreement))
    }));
    if !score.photos_without.is_empty() {
        lines.push(line("no product", score.photos_without.join(", ")));
    }
    lines
}

/// Returns how far depths are from ranges in one line.
fn agreement(found: &Agreement) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let pixels = count(found.product_pixels as usize, "pixel");
    let Some(difference) = &found.difference else {
        return format!("none of {pixels} has a depth");
    };
    format!(
        "{} of {pixels} have a depth. Median difference {:+.2} %, median error {} m ({:.2} %). Of these pixels 90 % are within {:.2} %, {} within 1 % and {} within 3 sigma",
        percent(found.share),
        100.0 * difference.median_share,
        number(difference.median_abs_m),
        100.0 * difference.median_abs_share,
        100.0 * difference.p90_abs_share,
        percent(difference.within_1_percent),
        percent(difference.within_3_sigma),
    )
}

/// Returns a stop in one line.
fn summary(scene: &SceneDepth) -> String {
    let SceneDepth { metrics, folder, .. } = scene;
    let map = match &metrics.map {
        Some(map) => format!(
            "a map of {} x {} pixels of {} m",
            map.columns,
            map.rows,
            number(map.pixel_m)
        ),
        None => "no map".to_owned(),
    };
    format!(
        "{:<12} {}, {}, {:.1} % of the pixels with a depth, {}, {map}, in {}",
        scene.name.as_deref().unwrap_or_default(),
        count(metrics.photos.len(), "photo"),
        count(matched(metrics), "pair"),
        100.0 * metrics.share,
        count(metrics.points as usize, "point"),
        folder.display()
    )
}

fn matched(metrics: &Metrics) -> usize {
    metrics.pairs.iter().filter(|pair| pair.reason.is_empty()).count()
}

fn table(scene: &SceneDepth) -> Vec<String> {
    let SceneDepth {
        cameras,
        metrics,
        seconds,
        folder,
        written,
        ..
    } = scene;
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let matched = matched(metrics);
    let refused: u64 = metrics.refused.values().sum();
    let with_depth = metrics.photos.iter().filter(|photo| photo.share > 0.0).count();
    let mut rows = vec![
        (
            "cameras",
            format!(
                "{}, {} of {} photos placed",
                cameras.method, cameras.totals.registered, cameras.totals.photos
            ),
        ),
        ("pairs", format!("{matched} matched, {refused} refused")),
    ];
    rows.extend(
        metrics
            .refused
            .iter()
            .map(|(reason, count)| ("", format!("{count}: {reason}"))),
    );
    rows.push((
        "depths",
        format!(
            "{} of the pixels, {} confirmed by two pairs",
            percent(metrics.share),
            percent(metrics.confirmed_share),
        ),
    ));
    rows.push((
        "",
        format!("{with_depth} of {} photos have any", metrics.photos.len()),
    ));
    if metrics.sky_share > 0.0 {
        let sky = format!("{} of the pixels, without a depth", percent(metrics.sky_share));
        rows.push(("sky", sky));
    }
    rows.extend(metrics.median_sigma_share.map(|share| {
        let sigma = format!("{} of the distance in the median", percent(share));
        ("sigma", sigma)
    }));
    rows.push((
        "points",
        format!(
            "{}, {} {} apart",
            metrics.points,
            number(metrics.cell),
            metrics.unit
        ),
    ));
    rows.extend(maps(metrics).into_iter().map(|map| ("map", map)));
    rows.push(("took", duration(*seconds)));
    rows.push((
        "wrote",
        format!(
            "{} pictures of photos below {}",
            6 * metrics.photos.len(),
            folder.display()
        ),
    ));
    rows.extend(written.iter().map(|path| ("", path.display().to_string())));
    let line = |(what, value): &(&str, String)| format!("{what:<12} {value}");
    rows.iter().map(line).collect()
}

/// Returns the size of the height map, or why there is none.
fn maps(metrics: &Metrics) -> Vec<String> {
    let Some(map) = &metrics.map else {
        return metrics.missing.values().cloned().collect();
    };
    vec![format!(
        "{} x {} pixels of {} m, {:.1} % with a height",
        map.columns,
        map.rows,
        number(map.pixel_m),
        100.0 * map.covered_share
    )]
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_table_has_the_numbers_of_depths_and_map() {
        let totals = json!({"photos": 4, "registered": 3, "held_out": 0, "unplaced": 1, "missing": 0, "points": 7,
                            "error_px": null, "error_working_px": null});
        let cameras = json!({"method": "import", "totals": totals, "photos": [], "missing": [], "up": null, "tie": null});
        let map = json!({"columns": 40, "rows": 30, "pixel_m": 0.05, "lowest_m": 0.0, "interval_m": 0.001, "first_m": [0.0, 0.0],
                         "axes": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "origin": "x", "covered_share": 0.625});
        let metrics = json!({"unit": "metres", "photos": [], "pairs": [], "refused": {"few": 2}, "share": 0.5, "confirmed_share": 0.25, "sky_share": 0.2,
                             "median_sigma_share": 0.0125, "points": 9, "cell": 0.1, "map": map, "missing": {}});
        let scene = SceneDepth {
            name: None,
            cameras: serde_json::from_value(cameras).unwrap(),
            metrics: serde_json::from_value(metrics).unwrap(),
            seconds: 2.0,
            folder: PathBuf::from("out"),
            written: Vec::new(),
        };
        let result = DepthResult {
            why_labels: None,
            scenes: vec![scene.clone()],
            score: None,
        };
        let lines = super::lines(&result);
        for line in [
            "cameras      import, 3 of 4 photos placed",
            "sky          20.0 % of the pixels, without a depth",
            "pairs        0 matched, 2 refused",
            "depths       50.0 % of the pixels, 25.0 % confirmed by two pairs",
            "sigma        1.2 % of the distance in the median",
            "map          40 x 30 pixels of 0.05 m, 62.5 % with a height",
        ] {
            assert!(lines.iter().any(|found| found == line), "{line}: {lines:#?}");
        }
        let nothing = Agreement {
            product_pixels: 1200,
            pixels: 0,
            share: 0.0,
            difference: None,
        };
        assert_eq!(agreement(&nothing), "none of 1,200 pixels has a depth");
        // Several stops have a line each.
        let stop = |name: &str| SceneDepth {
            name: Some(name.to_owned()),
            folder: PathBuf::from("out").join(name),
            ..scene.clone()
        };
        let result = DepthResult {
            why_labels: Some("structure from motion placed 2 of 9 photos".to_owned()),
            scenes: vec![stop("site3-1"), stop("site9-2")],
            score: None,
        };
        assert_eq!(
            super::lines(&result),
            [
                "cameras      structure from motion placed 2 of 9 photos",
                "site3-1      0 photos, 0 pairs, 50.0 % of the pixels with a depth, 9 points, a map of 40 x 30 pixels of 0.05 m, in out/site3-1",
                "site9-2      0 photos, 0 pairs, 50.0 % of the pixels with a depth, 9 points, a map of 40 x 30 pixels of 0.05 m, in out/site9-2",
            ]
        );
    }
}
