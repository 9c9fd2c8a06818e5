//! Relative positions of the scenes of a mission.

use marf_schema::ties::{SceneTie, TiedScene, Ties};
use maud::{Markup, html};

use super::format::{count, number};
use super::page::Page;

/// Most rows of a table. `ties.json` has all.
const MOST_ROWS: usize = 100;

/// Ties between scenes, their quality, and the frame of each scene. Empty without a node that ties scenes.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let read = page
        .with_document::<Ties>()
        .map(|node| page.document::<Ties>(node));
    html! {
        @for ties in read {
            @match ties {
                Ok(ties) => (of_ties(&ties)),
                Err(missing) => (missing),
            }
        }
    }
}

fn of_ties(ties: &Ties) -> Markup {
    html! {
        p { (said(ties)) }
        @if !ties.ties.is_empty() {
            div.scroll { table {
                thead { tr {
                    th { "Scenes" } th.number { "Pairs of photos" } th.number { "Points that agree" } th.number { "Off, px of 1,000" }
                    th.number { "Points apart, m" } th.number { "Labels off, m" } th.number { "Labels off, °" }
                } }
                tbody { @for tie in ties.ties.iter().take(MOST_ROWS) { (row(tie)) } }
            } }
        }
        (frames(&ties.scenes))
        @if !ties.apart.is_empty() {
            details {
                summary { (count(ties.apart.len(), "pair")) " of scenes compared and not tied" }
                div.scroll { table {
                    thead { tr { th { "Scenes" } th { "Why" } } }
                    tbody { @for apart in ties.apart.iter().take(MOST_ROWS) {
                        tr { td { (apart.scenes.join(", ")) } td { (apart.reason) } }
                    } }
                } }
            }
        }
    }
}

/// Returns the introduction of the section.
fn said(ties: &Ties) -> String {
    let gaps = ties.ties.iter().filter_map(|tie| tie.labels.as_ref());
    let mut shifts: Vec<f64> = gaps.map(|gap| length(&gap.shift_m)).collect();
    shifts.sort_unstable_by(f64::total_cmp);
    let tied = match ties.ties.len() {
        0 => return "No two scenes show common ground.".to_owned(),
        1 => "1 pair of scenes shows".to_owned(),
        many => format!("{} of scenes show", count(many, "pair")),
    };
    let labels = shifts.last().map_or_else(String::new, |most| {
        format!(
            " Where labels say too how they lie, they are up to {} m off.",
            number(*most)
        )
    });
    format!("{tied} common ground.{labels}")
}

fn row(tie: &SceneTie) -> Markup {
    let or_none = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), number);
    let of_labels =
        |value: &dyn Fn(&marf_schema::ties::LabelGap) -> f64| or_none(tie.labels.as_ref().map(value));
    html! {
        tr {
            td { (tie.scenes.join(", ")) }
            td.number { (tie.photo_pairs) }
            td.number { (tie.inliers) " of " (tie.points) }
            td.number { (format!("{:.2}", tie.median_px)) }
            td.number { (or_none(tie.median_m)) }
            td.number { (of_labels(&|gap| length(&gap.shift_m))) }
            td.number { (of_labels(&|gap| gap.angle_deg)) }
        }
    }
}

fn frames(scenes: &[TiedScene]) -> Markup {
    html! {
        div.scroll { table {
            thead { tr { th { "Scene" } th { "Lies in" } th { "By" } th { "Through" } } }
            tbody { @for scene in scenes.iter().take(MOST_ROWS) {
                tr {
                    td { (scene.name) } td { (scene.frame) } td { (scene.by.word()) } td { (scene.through.join(", ")) }
                }
            } }
        } }
    }
}

fn length([x, y, z]: &[f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_schema::ties::{By, LabelGap, Similarity};

    fn tie(shift_m: Option<[f64; 3]>) -> SceneTie {
        SceneTie {
            scenes: ["a".to_owned(), "b".to_owned()],
            photo_pairs: 3,
            points: 90,
            inliers: 60,
            median_px: 0.8,
            median_m: None,
            first_from_second: similarity(),
            labels: shift_m.map(|shift_m| LabelGap {
                shift_m,
                angle_deg: 0.2,
                scale: 1.0,
            }),
        }
    }

    fn similarity() -> Similarity {
        Similarity {
            scale: 1.0,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        }
    }

    #[test]
    fn the_largest_gap_of_labels_is_told_and_none_is_invented() {
        let mut ties = Ties {
            ties: vec![tie(None)],
            ..Ties::default()
        };
        assert_eq!(said(&ties), "1 pair of scenes shows common ground.");
        ties.ties.push(tie(Some([0.3, 0.4, 0.0])));
        assert!(
            said(&ties).starts_with("2 pairs of scenes show common"),
            "{}",
            said(&ties)
        );
        assert!(said(&ties).ends_with("up to 0.5 m off."), "{}", said(&ties));
        assert!(said(&Ties::default()).starts_with("No two scenes"));
        let text = row(&tie(None)).into_string();
        assert!(
            text.contains("60 of 90") && text.matches('–').count() == 3,
            "{text}"
        );
    }

    #[test]
    fn a_scene_that_nothing_ties_says_so() {
        let scenes = [TiedScene {
            name: "a".to_owned(),
            frame: "a".to_owned(),
            by: By::Itself,
            through: Vec::new(),
            frame_from_world: similarity(),
        }];
        assert!(frames(&scenes).into_string().contains("nothing ties it"));
    }
}
