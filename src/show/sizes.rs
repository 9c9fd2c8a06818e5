//! What a field was sized by: every number beside what decided it, and the parts that were tried.

use maud::{Markup, html};
use serde_json::Value;

use super::format::count;
use super::json::{self, text};

/// Sizes as `train` names them, as people do, and the unit.
const NAMES: [(&str, &str, &str); 6] = [
    ("near", "near", "half sides"),
    ("far", "far", "half sides"),
    ("finest", "cells a side of the finest level", ""),
    ("levels", "levels", ""),
    ("surface_cells", "finest cells with surface", ""),
    ("log2_table", "largest table, 2^", ""),
];

/// One row a size, and one a trial; nothing where the metrics are of no training.
pub(super) fn shown(metrics: &Value) -> Markup {
    let field = &metrics["field"];
    let Some(sizes) = field["sizes"].as_object() else {
        return html! {};
    };
    let rows = NAMES.iter().filter_map(|row| Some((row, sizes.get(row.0)?)));
    let trials = field["trials"].as_array().map_or(&[][..], Vec::as_slice);
    html! {
        details {
            summary { "what decided the size of the field" }
            div.scroll { table {
                tr { th scope="row" { "half side of the box" } td.number { (text(&field["half_side"])) }
                    td { (text(&field["box_reason"])) } }
                @for ((_, name, unit), size) in rows {
                    tr { th scope="row" { (name) } td.number { (text(&size["value"])) " " (unit) }
                        td { (text(&size["reason"])) } }
                }
            } }
            @if !trials.is_empty() {
                p { (count(trials.len(), "part")) " of the field, tried with and without:" }
                (json::table(trials))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_size_stands_beside_its_reason_and_every_trial_beside_its_decision() {
        let size = |value: f64, why: &str| json!({"value": value, "reason": why});
        let field = json!({
            "half_side": 3.5, "box_reason": "80 % of the points", "trials": [{"part": "gain", "decision": "left out: +0.02 dB"}],
            "sizes": {"near": size(0.25, "half of <that>"), "levels": size(8.0, "by 1.9 a level")},
        });
        let shown = shown(&json!({ "field": field })).into_string();
        for part in [
            "3.5",
            "80 % of the points",
            "0.25 half sides",
            "half of &lt;that&gt;",
            "by 1.9 a level",
            "left out: +0.02 dB",
        ] {
            assert!(shown.contains(part), "{part}: {shown}");
        }
        assert_eq!(super::shown(&json!({"psnr": 3.0})).into_string(), "");
    }
}
