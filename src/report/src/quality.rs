//! Figures of merit with their units.

use marf_scene::Nearest;
use marf_schema::scores::{PhotoScores, Scores};
use marf_schema::train::WarmStart;
use marf_schema::{bootstrap, calibrate, evaluate, folds, rigs, train};
use maud::{Markup, html};

use super::format::{decibels, length, number, similarity};

/// A figure: its name, its value with the unit.
pub type Figure = (&'static str, String);

/// Shows figures, large.
pub(super) fn figures(figures: &[Figure]) -> Markup {
    html! {
        dl.figures { @for (name, text) in figures { div { dt { (name) } dd { (text) } } } }
    }
}

/// Returns the figures of a training.
pub(super) fn of_training(metrics: &train::Metrics) -> Vec<Figure> {
    let counts = [
        ("steps", number(metrics.steps as f64)),
        ("photos trained on", number(metrics.train_photos as f64)),
        ("photos held out", number(metrics.held_out_photos as f64)),
        ("photos reduced by", number(f64::from(metrics.scale))),
    ];
    let judged = metrics.scores.views.len() as u64;
    let some = (judged != metrics.held_out_photos).then(|| ("photos judged", number(judged as f64)));
    let reduced = metrics.judged_scale;
    let reduced = reduced.map(|scale| ("judged at reduction by", number(f64::from(scale))));
    let target = metrics.target.iter().map(|target| {
        let how = target.reached_at.map_or_else(
            || format!("missed: {} dB", decibels(target.validation_psnr)),
            |steps| format!("reached after {} steps", number(steps as f64)),
        );
        (
            "target on photos held back",
            format!("{} dB {how}", number(target.psnr)),
        )
    });
    let start = metrics.warm_start.iter().map(|start| {
        let from = match start {
            WarmStart::From(weights) => format!("the field {} of the run before", weights.short()),
            WarmStart::Cold(why) => format!("nothing: {why}"),
        };
        ("began from", from)
    });
    let exposure = metrics.exposure().map(|words| ("exposure", words));
    let vignetting = metrics.vignetting().map(|words| ("vignetting", words));
    let seen = metrics.on_training.iter();
    let seen = seen.map(|seen| ("PSNR on photos trained on", format!("{} dB", decibels(seen.psnr))));
    means(&metrics.scores)
        .into_iter()
        .chain(seen)
        .chain(target)
        .chain(exposure)
        .chain(vignetting)
        .chain(start)
        .chain(counts)
        .chain(some)
        .chain(reduced)
        .collect()
}

/// Returns the figures of folds.
pub(super) fn of_folds(judged: &folds::Judged) -> Vec<Figure> {
    let counts = [
        (
            "photos, each held out once",
            number(judged.scores.views.len() as f64),
        ),
        ("trainings", number(judged.folds.len() as f64)),
        ("steps of each", number(judged.steps as f64)),
    ];
    means(&judged.scores).into_iter().chain(counts).collect()
}

/// Returns the figures of an evaluation.
pub(super) fn of_evaluation(metrics: &evaluate::Metrics) -> Vec<Figure> {
    let scale = ("photos reduced by", number(f64::from(metrics.scale)));
    means(&metrics.scores).into_iter().chain([scale]).collect()
}

/// Returns the figures of a bootstrap.
pub(super) fn of_bootstrap(metrics: &bootstrap::Metrics) -> Vec<Figure> {
    vec![("retrainings (members)", number(f64::from(metrics.b)))]
}

/// Returns the figures of a calibration.
pub(super) fn of_calibration(metrics: &calibrate::Metrics) -> Vec<Figure> {
    let totals = &metrics.totals;
    let error = totals.error_px.map(|error| format!("{} px", number(error)));
    let error = error.map(|error| ("reprojection error", error));
    let placed = ("photos placed", number(totals.registered as f64));
    let tie = metrics.tie.map(|tie| {
        let median = format!(
            "{} m, {} m at most (site {})",
            length(tie.median_m),
            length(tie.largest_m),
            tie.site
        );
        ("cameras from their labels", median)
    });
    let up = metrics.up.map(|up| ("up", up.words()));
    let rigs = rigs::words(&metrics.stereo_pairs).map(|words| ("stereo pairs", words));
    [placed]
        .into_iter()
        .chain(error)
        .chain(tie)
        .chain(rigs)
        .chain(up)
        .collect()
}

/// Returns the figures of one photo.
pub(super) fn of_photo(scores: &PhotoScores) -> Vec<Figure> {
    let paper = "PSNR as in the paper";
    let figures = of_scores(scores.psnr, scores.psnr_paper, scores.ssim, paper);
    let nearest = scores.nearest.iter().flat_map(|nearest| {
        let place = ("nearest photo trained on", place_of(nearest));
        let share = ("not seen in training", percent(nearest.uncovered_share));
        [Some(place), nearest.extrapolates.then_some(share)]
    });
    figures.into_iter().chain(nearest.flatten()).collect()
}

/// Returns how far away the nearest photo is: in metres where the scene has a scale, and by direction.
fn place_of(nearest: &Nearest) -> String {
    let distance = match nearest.distance_m {
        Some(metres) => format!("{} m", length(metres)),
        None => format!("{} units", length(nearest.distance)),
    };
    format!("{distance}, {:.0}°", nearest.angle_deg)
}

/// Returns a share as a whole number of per cent.
pub(super) fn percent(share: f64) -> String {
    format!("{:.0} %", share * 100.0)
}

/// Shows the photos of a node by their distance to the nearest photo trained on, nearest first. Empty if no
/// distance is known.
pub(super) fn by_distance(scores: &Scores) -> Markup {
    let views = scores.views.iter();
    let mut rows: Vec<(&PhotoScores, &Nearest)> = views
        .filter_map(|view| Some((view, view.nearest.as_ref()?)))
        .collect();
    rows.sort_by(|(_, a), (_, b)| a.distance.total_cmp(&b.distance));
    html! {
        @if !rows.is_empty() {
            details {
                summary { "PSNR by distance to the nearest photo trained on" }
                table {
                    thead { tr {
                        th { "photo" } th { "nearest" } th { "PSNR, dB" } th { "not seen in training" } th {}
                    } }
                    tbody { @for (view, nearest) in rows { tr {
                        th scope="row" { (view.name) }
                        td.number { (place_of(nearest)) }
                        td.number { (decibels(view.psnr)) }
                        td.number { (percent(nearest.uncovered_share)) }
                        td { @if nearest.extrapolates { "extrapolation" } }
                    } } }
                }
            }
        }
    }
}

/// Returns a number with two significant digits, as nobody measures by a summary.
pub(super) fn rounded(value: f64) -> String {
    let step = 10_f64.powf(value.abs().log10().floor() - 1.0);
    if step > 0.0 && step.is_finite() {
        number((value / step).round() * step)
    } else {
        number(0.0)
    }
}

fn means(scores: &Scores) -> Vec<Figure> {
    let paper = "PSNR as in the paper";
    let mut figures = of_scores(scores.psnr, scores.psnr_paper, scores.ssim, paper);
    let in_db = |value: f64| format!("{} dB", decibels(value));
    let affine = scores.psnr_affine.map(in_db);
    figures.extend(affine.map(|psnr| ("PSNR after an affine fit to each photo", psnr)));
    if let Some(apart) = &scores.apart {
        let others = apart.psnr_others.map(in_db);
        figures.extend(others.map(|psnr| ("PSNR without extrapolation", psnr)));
        figures.push(("photos that extrapolate", number(apart.extrapolated as f64)));
    }
    figures
}

fn of_scores(psnr: f64, psnr_paper: Option<f64>, ssim: Option<f64>, paper: &'static str) -> Vec<Figure> {
    let in_db = |value: f64| format!("{} dB", decibels(value));
    let all = [
        Some(("PSNR", in_db(psnr))),
        psnr_paper.map(|value| (paper, in_db(value))),
        ssim.map(|value| ("SSIM", similarity(value))),
    ];
    all.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_carry_their_unit_and_skip_what_was_not_measured() {
        let found = of_scores(27.318, None, Some(0.9), "paper");
        let expected = [("PSNR", "27.32 dB".to_owned()), ("SSIM", "0.900".to_owned())];
        assert_eq!(found, expected);
    }

    #[test]
    fn a_summary_has_two_significant_digits() {
        let values = [10.45, 8.039, 0.01234, 1234.0, 0.0, f64::INFINITY];
        assert_eq!(values.map(rounded), ["10", "8", "0.012", "1,200", "0", "0"]);
    }
}
