//! Numbers that decided the size of a field, each with its reason.

use marf_field::Facts;
use maud::{Markup, html};

use super::format::number;

/// Shows one row a size.
pub(super) fn shown(facts: &Facts) -> Markup {
    html! {
        details {
            summary { "what decided the size of the field" }
            div.scroll { table {
                tr { th scope="row" { "half side of the box" } td.number { (number(facts.half_side)) }
                    td { (facts.box_reason) } }
                @if facts.transparent_photos > 0 {
                    tr { th scope="row" { "photos with transparency" }
                        td.number { (facts.transparent_photos) }
                        td { "their rays train over a random colour each" } }
                }
                @for (name, size, unit, reason) in rows(facts) {
                    tr { th scope="row" { (name) } td.number { (number(size)) " " (unit) } td { (reason) } }
                }
            } }
        }
    }
}

/// Name, value, unit and reason of each size.
fn rows(facts: &Facts) -> [(&'static str, f64, &'static str, &str); 10] {
    let sizes = &facts.sizes;
    let (near, far) = (&sizes.near, &sizes.far);
    let (finest, levels) = (&sizes.finest, &sizes.levels);
    let (surface, table) = (&sizes.surface_cells, &sizes.log2_table);
    [
        ("near", near.value, "half sides", &near.reason),
        ("far", far.value, "half sides", &far.reason),
        (
            "cells a side of the finest level",
            f64::from(finest.value),
            "",
            &finest.reason,
        ),
        ("levels", f64::from(levels.value), "", &levels.reason),
        (
            "finest cells with surface",
            surface.value as f64,
            "",
            &surface.reason,
        ),
        (
            "of them with detail",
            sizes.detail.value,
            "",
            &sizes.detail.reason,
        ),
        ("largest table, 2^", f64::from(table.value), "", &table.reason),
        (
            "weight of the distortion loss at the end",
            sizes.distortion.value[1],
            "",
            &sizes.distortion.reason,
        ),
        (
            "steps for which points and distances pull",
            f64::from(sizes.depth_steps.value),
            "",
            &sizes.depth_steps.reason,
        ),
        (
            "pull of the tables to zero at the start",
            sizes.table_decay.value,
            "",
            &sizes.table_decay.reason,
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture_documents::facts;

    #[test]
    fn every_size_stands_beside_its_reason() {
        let facts = Facts {
            transparent_photos: 12,
            ..facts()
        };
        let shown = shown(&facts).into_string();
        for part in [
            "3.5",
            "80 % of the points",
            "0.25 half sides",
            "half of &lt;that&gt;",
            "by 1.9 a level",
            "half of them",
            "1.00e-6",
            "ten photos",
            "a random colour each",
        ] {
            assert!(shown.contains(part), "{part}: {shown}");
        }
    }
}
