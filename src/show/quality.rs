//! Figures of merit with their units.

use maud::{Markup, html};
use serde_json::Value;

use super::format;

/// Known figures: key, name, unit.
const KNOWN: [(&str, &str, &str); 10] = [
    ("psnr", "PSNR", "dB"),
    ("psnr_paper", "PSNR, peak of the picture", "dB"),
    ("ssim", "SSIM", ""),
    ("steps", "steps", ""),
    ("train_photos", "photos trained on", ""),
    ("held_out_photos", "photos held out", ""),
    ("scale", "photos reduced by", ""),
    ("b", "members", ""),
    ("registered", "photos placed", ""),
    ("error_px", "reprojection error", "px"),
];

/// The figures people look for first, large.
pub(super) fn figures(metrics: &Value) -> Markup {
    let found = KNOWN
        .iter()
        .filter_map(|(key, name, unit)| Some((name, figure(metrics, key, unit)?)));
    html! {
        dl.figures { @for (name, text) in found { div { dt { (name) } dd { (text) } } } }
    }
}

/// A figure with its unit, where it is recorded as a number.
pub(super) fn figure(metrics: &Value, key: &str, unit: &str) -> Option<String> {
    let value = metrics.get(key)?.as_f64()?;
    let text = format::figure(key, value);
    Some(if unit.is_empty() {
        text
    } else {
        format!("{text} {unit}")
    })
}

/// The metrics less their views, which stand beside the pictures.
pub(super) fn without_views(metrics: &Value) -> Value {
    let mut metrics = metrics.clone();
    if let Some(fields) = metrics.as_object_mut() {
        fields.remove("views");
    }
    metrics
}

/// The record of one view by the name of its picture; names may be with or without ending.
pub(super) fn view<'m>(metrics: &'m Value, picture: &str) -> Option<&'m Value> {
    let views = metrics.get("views")?.as_array()?;
    let named = |view: &&Value, same: fn(&str, &str) -> bool| {
        let names = ["name", "id", "file"]
            .iter()
            .filter_map(|key| view.get(key)?.as_str());
        names.into_iter().any(|name| same(name, picture))
    };
    let exact = views
        .iter()
        .find(|view| named(view, |name, picture| name == picture));
    exact.or_else(|| {
        views
            .iter()
            .find(|view| named(view, |name, picture| stem(name) == picture))
    })
}

fn stem(name: &str) -> &str {
    let file = name.rsplit('/').next().unwrap_or(name);
    file.rsplit_once('.').map_or(file, |(stem, _)| stem)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_view_is_found_by_name_before_stem() {
        let metrics = json!({"views": [
            {"id": "x/a.png", "psnr": 1.0},
            {"id": "9", "file": "b.jpg", "name": "a", "psnr": 2.0},
        ]});
        assert_eq!(view(&metrics, "a").unwrap()["psnr"], 2.0);
        assert_eq!(view(&metrics, "b").unwrap()["psnr"], 2.0);
        assert_eq!(view(&metrics, "c"), None);
        assert_eq!(view(&json!({"views": 3}), "a"), None);
    }

    #[test]
    fn figures_carry_their_unit_and_skip_what_is_no_number() {
        let metrics = json!({"psnr": 27.318, "ssim": 0.9, "scale": "none"});
        assert_eq!(figure(&metrics, "psnr", "dB").as_deref(), Some("27.32 dB"));
        assert_eq!(figure(&metrics, "ssim", "").as_deref(), Some("0.900"));
        assert_eq!(figure(&metrics, "scale", ""), None);
    }
}
