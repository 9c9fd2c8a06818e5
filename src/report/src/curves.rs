//! Training: figures of merit and how they grew.

use marf_model::RunNode;
use marf_schema::train::{Curve, CurvePoint};
use marf_schema::{evaluate, folds, scores::Scores, train};
use maud::{Markup, html};

use super::axis::{Chart, Scale};
use super::format::{count, number};
use super::json;
use super::page::Page;
use super::quality::{figures, of_evaluation, of_folds, of_training};
use super::read::Missing;
use super::sizes;

/// Shows metrics and curves of every training, and metrics of every evaluation.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let trained: Vec<&RunNode> = page.with_document::<Curve>().collect();
    let evaluated: Vec<&RunNode> = page.with_document::<evaluate::Metrics>().collect();
    let folds: Vec<&RunNode> = page.with_document::<folds::Metrics>().collect();
    if trained.is_empty() && folds.is_empty() && evaluated.is_empty() {
        return page.absent("training curves or metrics");
    }
    html! {
        @for node in trained { h3 { (node.run.name) } (training(page, node)) (curves(page, node)) }
        @for node in folds { h3 { (node.run.name) } (folded(page, node)) }
        @for node in evaluated { h3 { (node.run.name) } (evaluation(page, node)) }
    }
}

fn training(page: &Page<'_>, node: &RunNode) -> Markup {
    let shown = |metrics: train::Metrics| {
        let alone = train::Metrics {
            scores: without_views(&metrics.scores),
            drawn: None, // as many ids as photos
            ..metrics.clone()
        };
        html! {
            (figures(&of_training(&metrics)))
            (sizes::shown(&metrics.field))
            (json::folded("all metrics", &alone))
        }
    };
    page.document(node).map_or_else(sentence, shown)
}

/// Every photo of a small scene held out once, or why not.
fn folded(page: &Page<'_>, node: &RunNode) -> Markup {
    let metrics: folds::Metrics = match page.document(node) {
        Ok(metrics) => metrics,
        Err(missing) => return sentence(missing),
    };
    match &metrics.judged {
        Some(judged) => html! {
            (figures(&of_folds(judged)))
            p {
                "A scene of fewer than " (metrics.below) " photos is judged on all of them: each by a field that was trained without \
                 its place, for " (number(judged.steps as f64)) " steps of the " (number(judged.steps_of_whole as f64))
                " that the delivered field has."
            }
        },
        None if metrics.photos >= u64::from(metrics.below) => html! {
            p.quiet { (metrics.photos) " photos: not judged by folds, which is for scenes of fewer than " (metrics.below) "." }
        },
        None => {
            html! { p.quiet { "All photos were taken at one place: a fold would hold out all or none." } }
        }
    }
}

fn evaluation(page: &Page<'_>, node: &RunNode) -> Markup {
    let shown = |metrics: evaluate::Metrics| {
        let scores = without_views(&metrics.scores);
        html! {
            (figures(&of_evaluation(&metrics)))
            (json::folded("all metrics", &evaluate::Metrics { scores, ..metrics }))
        }
    };
    page.document(node).map_or_else(sentence, shown)
}

fn sentence(missing: Missing) -> Markup {
    html! { (missing) }
}

/// The means alone, as each photo's scores are shown next to its pictures.
fn without_views(scores: &Scores) -> Scores {
    Scores {
        views: Vec::new(),
        ..scores.clone()
    }
}

fn curves(page: &Page<'_>, node: &RunNode) -> Markup {
    let points = match page.document(node) {
        Ok(Curve(points)) => points,
        Err(missing) => return sentence(missing),
    };
    let steps: Vec<f64> = points.iter().map(|point| point.step as f64).collect();
    let record = node.record.as_ref();
    let training_s = record.and_then(|record| record.metadata.parts_s.get("training"));
    let seconds = training_s.and_then(|whole_s| seconds(&points, *whole_s));
    let psnr = |title, x_label, along: &[f64]| Chart {
        title,
        x_label,
        y_label: "PSNR, dB",
        scale: Scale::Linear,
        lines: vec![line(&points, along, |point| point.psnr)],
    };
    let loss = |title, x_label, along: &[f64]| Chart {
        title,
        x_label,
        y_label: "loss",
        scale: Scale::Log,
        lines: vec![line(&points, along, |point| point.loss)],
    };
    html! {
        div.charts {
            (psnr("PSNR against step", "step", &steps).drawn())
            (loss("Loss against step", "step", &steps).drawn())
            @if let Some(seconds) = &seconds {
                (psnr("PSNR against seconds", "seconds", seconds).drawn())
                (loss("Loss against seconds", "seconds", seconds).drawn())
            }
        }
        @if let Ok(metrics) = page.document::<train::Metrics>(node) { p.quiet { (curve_photos(&metrics)) } }
        @if let Some(last) = points.last() {
            p.quiet {
                (number(last.rays as f64)) " rays, " (number(last.samples as f64)) " samples in all."
                @if seconds.is_some() {
                    " Seconds: the time of all steps on the machine that made it, shared out by samples. Reading photos and judging take additional time."
                }
            }
        }
    }
}

/// Returns on which photos a curve and the figures above it are measured.
fn curve_photos(metrics: &train::Metrics) -> String {
    let on_curve = Curve::MOST_PHOTOS.min(metrics.held_out_photos as usize);
    let judged = metrics.scores.views.len();
    let scale = metrics.judged_scale.unwrap_or(metrics.scale);
    let size = if scale > 1 {
        format!("reduced by {scale}")
    } else {
        "in full size".to_owned()
    };
    format!(
        "PSNR of the curves: {} of those held out, thinned to at most {} pixels a side. PSNR of the figures above: {}, {size}. \
         So the last point of a curve is not that figure.",
        count(on_curve, "photo"),
        Curve::SIDE_PX,
        count(judged, "photo"),
    )
}

/// Returns when each point of a curve was reached: the seconds of all steps, divided in proportion to
/// samples, which are the cost of a step. `None` if no sample was taken.
fn seconds(points: &[CurvePoint], whole_s: f64) -> Option<Vec<f64>> {
    let all = points.last()?.samples;
    let at = |point: &CurvePoint| whole_s * point.samples as f64 / all as f64;
    (all > 0).then(|| points.iter().map(at).collect())
}

/// Returns the line of one value of a curve's points, without a name.
fn line(
    points: &[CurvePoint],
    along: &[f64],
    value: fn(&CurvePoint) -> f64,
) -> (&'static str, Vec<(f64, f64)>) {
    ("", along.iter().copied().zip(points.iter().map(value)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture_documents::training;
    use marf_schema::example;

    #[test]
    fn a_curve_says_that_its_photos_and_sizes_are_not_those_of_the_figures() {
        let metrics = training(example::scores());
        let (judged, sentence) = (metrics.scores.views.len(), curve_photos(&metrics));
        let expected = format!("figures above: {}, reduced by 4.", count(judged, "photo"));
        assert!(sentence.contains(&expected), "{sentence}");
        assert!(
            sentence.contains("3 photos of those held out, thinned to at most 64 pixels"),
            "{sentence}"
        );
        let whole = train::Metrics {
            judged_scale: Some(1),
            held_out_photos: 1,
            ..metrics
        };
        let sentence = curve_photos(&whole);
        assert!(
            sentence.contains("1 photo of those held out") && sentence.contains("in full size"),
            "{sentence}"
        );
    }

    #[test]
    fn seconds_are_shared_out_by_samples() {
        let point = |step, samples| CurvePoint {
            step,
            samples,
            rays: 0,
            loss: 0.1,
            psnr: 20.0,
        };
        let points = [point(1, 100), point(2, 400), point(4, 1000)];
        assert_eq!(seconds(&points, 20.0), Some(vec![2.0, 8.0, 20.0]));
        assert_eq!(seconds(&[point(0, 0)], 20.0), None);
        assert_eq!(seconds(&[], 20.0), None);
    }
}
