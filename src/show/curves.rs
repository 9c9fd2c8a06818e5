//! Training: figures of merit and how they grew.

use marf_schema::train::{Curve, CurvePoint};
use marf_schema::{evaluate, folds, scores::Scores, train};
use maud::{Markup, html};

use super::axis::{Chart, Scale};
use super::format::number;
use super::input::NodeView;
use super::json;
use super::page::Page;
use super::quality::{figures, of_evaluation, of_folds, of_training};
use super::read::Missing;
use super::sizes;

/// Shows metrics and curves of every training, and metrics of every evaluation.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let trained: Vec<&NodeView> = page.with_document::<Curve>().collect();
    let evaluated: Vec<&NodeView> = page.with_document::<evaluate::Metrics>().collect();
    let folds: Vec<&NodeView> = page.with_document::<folds::Metrics>().collect();
    if trained.is_empty() && folds.is_empty() && evaluated.is_empty() {
        return page.absent("training curves or metrics");
    }
    html! {
        @for node in trained { h3 { (node.name) } (training(page, node)) (curves(page, node)) }
        @for node in folds { h3 { (node.name) } (folded(page, node)) }
        @for node in evaluated { h3 { (node.name) } (evaluation(page, node)) }
    }
}

fn training(page: &Page<'_>, node: &NodeView) -> Markup {
    let shown = |metrics: train::Metrics| {
        let scores = without_views(&metrics.scores);
        html! {
            (figures(&of_training(&metrics)))
            (sizes::shown(&metrics.field))
            details { summary { "all metrics" } (json::fields(&train::Metrics { scores, ..metrics })) }
        }
    };
    page.document(node).map_or_else(sentence, shown)
}

/// Every photo of a small scene held out once, or why not.
fn folded(page: &Page<'_>, node: &NodeView) -> Markup {
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
        None => html! { p.quiet { "All photos stand in one place: a fold would hold out all or none." } },
    }
}

fn evaluation(page: &Page<'_>, node: &NodeView) -> Markup {
    let shown = |metrics: evaluate::Metrics| {
        let scores = without_views(&metrics.scores);
        html! {
            (figures(&of_evaluation(&metrics)))
            details { summary { "all metrics" } (json::fields(&evaluate::Metrics { scores, ..metrics })) }
        }
    };
    page.document(node).map_or_else(sentence, shown)
}

fn sentence(missing: Missing) -> Markup {
    html! { (missing) }
}

/// The means alone: each photo's scores stand beside its pictures.
fn without_views(scores: &Scores) -> Scores {
    Scores {
        views: Vec::new(),
        ..scores.clone()
    }
}

fn curves(page: &Page<'_>, node: &NodeView) -> Markup {
    let points = match page.document(node) {
        Ok(Curve(points)) => points,
        Err(missing) => return sentence(missing),
    };
    let chart = |title, label, scale, value: fn(&CurvePoint) -> f64| Chart {
        title,
        x_label: "step",
        y_label: label,
        scale,
        lines: vec![(
            "",
            points
                .iter()
                .map(|point| (point.step as f64, value(point)))
                .collect(),
        )],
    };
    html! {
        div.charts {
            (chart("PSNR against step", "PSNR, dB", Scale::Linear, |point| point.psnr).drawn())
            (chart("Loss against step", "loss", Scale::Log, |point| point.loss).drawn())
        }
        @if let Some(last) = points.last() {
            p.quiet { (number(last.rays as f64)) " rays, " (number(last.samples as f64)) " samples in all." }
        }
    }
}
