//! Training: figures of merit and how they grew.

use marf_stage::PHOTOS;
use maud::{Markup, html};
use serde_json::Value;

use super::axis::{Chart, Scale};
use super::format::number;
use super::input::NodeView;
use super::json;
use super::page::Page;
use super::quality::{figures, without_views};
use super::sizes;

/// Curves and metrics of every node that has either.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let trained: Vec<&NodeView> = page.with_output("curve").collect();
    let measured = |node: &&NodeView| !node.outputs.contains_key("curve") && is_measured(node);
    let others: Vec<&NodeView> = page.with_output("metrics").filter(measured).collect();
    if trained.is_empty() && others.is_empty() {
        return page.absent("training curves or metrics");
    }
    html! {
        @for node in trained { h3 { (node.name) } (metrics(page, node)) (curves(page, node)) }
        @for node in others { h3 { (node.name) } (metrics(page, node)) }
    }
}

/// Metrics of calibrations and of maps stand in their own sections.
fn is_measured(node: &NodeView) -> bool {
    let elsewhere = |name: &String| name.starts_with("maps/") || name == PHOTOS;
    let renders = node.outputs.keys().any(|name| name.starts_with("heldout/"));
    renders || !(node.outputs.contains_key("scene") || node.outputs.keys().any(elsewhere))
}

fn metrics(page: &Page<'_>, node: &NodeView) -> Markup {
    if !node.outputs.contains_key("metrics") {
        return html! {};
    }
    match page.json::<Value>(node, "metrics") {
        Ok(value) => html! {
            (figures(&value))
            (sizes::shown(&value))
            details { summary { "all metrics" } (json::tables(&without_views(&value))) }
        },
        Err(missing) => html! { (missing) },
    }
}

fn curves(page: &Page<'_>, node: &NodeView) -> Markup {
    let points: Vec<Value> = match page.json(node, "curve") {
        Ok(points) => points,
        Err(missing) => return html! { (missing) },
    };
    let chart = |title, key, label, scale| Chart {
        title,
        x_label: "step",
        y_label: label,
        scale,
        points: line(&points, key),
    };
    html! {
        div.charts {
            (chart("PSNR against step", "psnr", "PSNR, dB", Scale::Linear).drawn())
            (chart("Loss against step", "loss", "loss", Scale::Log).drawn())
        }
        (work_done(&points))
    }
}

fn line(points: &[Value], key: &str) -> Vec<(f64, f64)> {
    let value = |point: &Value, key: &str| point.get(key).and_then(Value::as_f64);
    points
        .iter()
        .filter_map(|point| Some((value(point, "step")?, value(point, key)?)))
        .collect()
}

/// Says how much work the last point of the curve stands for.
fn work_done(points: &[Value]) -> Markup {
    let last = |key: &str| {
        points
            .last()
            .and_then(|point| point.get(key))
            .and_then(Value::as_f64)
    };
    html! {
        @if let (Some(rays), Some(samples)) = (last("rays"), last("samples")) {
            p.quiet { (number(rays)) " rays, " (number(samples)) " samples in all." }
        }
    }
}
