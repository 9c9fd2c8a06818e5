//! Photos that calibration left without a camera: why, and what to do.

use std::collections::BTreeMap;

use marf_scene::Unplaced;
use maud::{Markup, html};

use super::format::count;

/// Rows of a table. The others are counted by advice.
const MOST_ROWS: usize = 200;

/// Beginnings of reasons, with the advice for each.
const ADVICE: [(&str, &str); 10] = [
    (
        "too few features",
        "leave blurred photos out, or look closer: `first_octave = \"doubled\"`, a larger `feature_side_px`",
    ),
    (
        "no overlap",
        "add the photos between, compare all with `pairs = \"exhaustive\"`, or lower `min_matches`",
    ),
    (
        "panorama",
        "the camera only turned: add photos from other places, or take `method = \"labels\"`",
    ),
    (
        "component",
        "nothing links these photos to the scene: add photos between, or calibrate them by themselves",
    ),
    (
        "linked to the scene",
        "raise `max_features`, or lower `min_matches`",
    ),
    (
        "no pair of photos",
        "add photos from places farther apart: a tenth of the distance to what they show",
    ),
    (
        "no three photos",
        "add photos from places farther apart: a tenth of the distance to what they show",
    ),
    ("a single photo", "add photos from other places"),
    (
        "no label",
        "fetch the labels with the photos, or take `method = \"sfm\"`, which needs none",
    ),
    (
        "an ideal pinhole",
        "the photo is too small for the lens of its label: leave thumbnails out (`size`, `shape`)",
    ),
];

fn advice(reason: &str) -> &'static str {
    let known = ADVICE.iter().find(|(begin, _)| reason.starts_with(begin));
    known.map_or("", |(_, advice)| advice)
}

/// Draws the table. Empty if every photo has a camera.
pub(super) fn table(unplaced: &[Unplaced]) -> Markup {
    let (shown, more) = unplaced.split_at(unplaced.len().min(MOST_ROWS));
    html! {
        @if !unplaced.is_empty() {
            h4 { (count(unplaced.len(), "photo")) " without a camera" }
            div.scroll {
                table {
                    thead { tr { th { "Photo" } th { "Why" } th { "What to do" } } }
                    tbody {
                        @for photo in shown {
                            tr { td.file { (photo.id) } td { (photo.reason) } td { (advice(&photo.reason)) } }
                        }
                    }
                }
            }
            @if !more.is_empty() {
                p { (count(more.len(), "photo")) " more, each with its reason in " code { "metrics.json" } " of the calibration:" }
                ul { @for (advice, photos) in by_advice(more) { li { (count(photos, "photo")) ": " (advice) } } }
            }
        }
    }
}

/// Counts photos by the advice for them.
fn by_advice(unplaced: &[Unplaced]) -> BTreeMap<&str, usize> {
    let mut counted = BTreeMap::new();
    for photo in unplaced {
        let advice = match advice(&photo.reason) {
            "" => &photo.reason,
            advice => advice,
        };
        *counted.entry(advice).or_default() += 1;
    }
    counted
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lost(reasons: impl IntoIterator<Item = &'static str>) -> String {
        let photo = |(index, reason): (usize, &str)| Unplaced {
            id: format!("photo-{index}"),
            reason: reason.to_owned(),
        };
        let unplaced: Vec<Unplaced> = reasons.into_iter().enumerate().map(photo).collect();
        table(&unplaced).into_string()
    }

    #[test]
    fn every_lost_photo_has_what_to_do_beside_its_reason() {
        let page = lost([
            "no overlap: at most 3 matches with any other photo hold",
            "of no known kind",
        ]);
        assert!(
            page.contains("compare all with `pairs = &quot;exhaustive&quot;`"),
            "{page}"
        );
        assert!(page.contains("<td>of no known kind</td><td></td>"), "{page}");
        assert_eq!(lost([]), "");
    }

    #[test]
    fn of_very_many_the_first_are_named_and_the_others_counted() {
        let reasons = (0..5_000).map(|index| if index % 2 == 0 { "no label" } else { "x" });
        let page = lost(reasons);
        assert_eq!(page.matches("<tr>").count(), 1 + MOST_ROWS);
        assert!(
            page.contains("4,800 photos more") && page.contains("<li>2,400 photos: x</li>"),
            "{page}"
        );
        assert!(page.len() < 60_000, "{} bytes", page.len());
    }
}
