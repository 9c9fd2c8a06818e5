//! First screen: what the run made in a sentence and five figures, a picture of it next to its cameras, and what to know.

use marf_numeric::quantile;
use marf_scene::Scene;
use marf_schema::scores::Scores;
use marf_schema::{bootstrap, calibrate, output, train};
use marf_stage::Document;
use maud::{Markup, html};

use super::camera_view::Axes;
use super::cameras;
use super::format::{count, decibels, number};
use super::page::Page;
use super::pictures;
use super::quality::{Figure, figures};
use super::vector::{Vec3, dot};

/// Most things to know that are listed.
const MOST_NOTES: usize = 5;
/// The extent holds the sparse points between this quantile and its mirror, along each axis of the ground.
const STRAY: f64 = 0.05;
/// Fewer held-out photos than this say little about other views.
const FEW_HELD_OUT: usize = 5;

/// What the first screen says. What the run did not make is absent.
#[derive(Default)]
struct Facts {
    /// Photos that were read.
    found: Option<usize>,
    /// Photos that every filter kept.
    kept: Option<usize>,
    totals: Option<calibrate::Totals>,
    scene: Option<Scene>,
    /// Scores of the last training on its held-out photos.
    scores: Option<Scores>,
    /// The training that has no result yet, if that of the scores is a draft.
    awaited: Option<String>,
    /// Whether a node maps the uncertainty, or will.
    has_uncertainty: bool,
    /// Share of the held-out photos that shows what no photo trained on saw, by the maps of the last bootstrap.
    invented_share: Option<f64>,
}

/// A thing to know, and the section that shows it.
struct Note {
    text: String,
    section: &'static str,
}

/// Returns the result in a sentence, then figures, pictures and notes.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let facts = Facts::new(page);
    let (sentence, notes) = (facts.sentence(), facts.notes(page));
    html! {
        (super::nodes::standing(page.report))
        (super::nodes::failures(page.report))
        @if !sentence.is_empty() { p.lead { (sentence) } }
        (super::nodes::of_earlier_run(page.report))
        (figures(&facts.figures()))
        div.first {
            (pictures::best(page))
            @if let Some(scene) = facts.scene.as_ref().filter(|scene| !scene.frames.is_empty()) {
                figure { (cameras::overview(scene)) figcaption { "cameras from above" } }
            }
        }
        @if !notes.is_empty() {
            ul.know {
                @for note in notes.iter().take(MOST_NOTES) {
                    li { (note.text) " " a href={ "#" (note.section) } { "Details" } }
                }
            }
        }
    }
}

/// Returns the figures of the first screen.
pub(super) fn figures_of(page: &Page<'_>) -> Vec<Figure> {
    Facts::new(page).figures()
}

impl Facts {
    fn new(page: &Page<'_>) -> Self {
        let read = page.judged().filter(|(node, _)| node.run.edges.is_empty());
        let read: Vec<usize> = read.filter_map(|(_, sum)| Some(sum.ok()?.seen)).collect();
        let kept = page.kept.iter().filter_map(|(_, kept)| kept.as_ref().ok());
        let kept: Vec<usize> = kept.map(|kept| kept.count).collect();
        let sum = |counts: Vec<usize>| (!counts.is_empty()).then(|| counts.iter().sum());
        let calibration = page.with_document::<calibrate::Metrics>().last();
        let training = page.training();
        let metrics = training.and_then(|node| page.document::<train::Metrics>(node).ok());
        let scene = page.with_output(output::SCENE).last();
        let bootstrap = page.with_document::<bootstrap::Metrics>().last();
        let maps = bootstrap.and_then(|node| page.document::<bootstrap::Metrics>(node).ok());
        Self {
            found: sum(read),
            kept: sum(kept),
            totals: calibration.and_then(|node| Some(page.document::<calibrate::Metrics>(node).ok()?.totals)),
            scene: scene.and_then(|node| cameras::scene(page, node).ok()),
            scores: metrics
                .map(|metrics| metrics.scores)
                .filter(|scores| !scores.views.is_empty()),
            awaited: training
                .and_then(|node| page.awaited(node))
                .map(|node| node.run.name.clone()),
            has_uncertainty: page
                .report
                .nodes
                .iter()
                .any(|node| node.run.stage == <bootstrap::Metrics as Document>::STAGE),
            invented_share: maps
                .filter(|metrics| metrics.heldout.is_some())
                .map(|metrics| metrics.unseen_share),
        }
    }

    /// Returns the photos of the run: those that were read, or else those that the calibration was given.
    fn photos(&self) -> Option<usize> {
        self.found
            .or_else(|| self.totals.as_ref().map(|totals| totals.photos))
    }

    fn sentence(&self) -> String {
        let mut sentences = Vec::new();
        if let Some(photos) = self.photos() {
            let photos = count(photos, "photo");
            let size = self.scene.as_ref().and_then(extent);
            let size = size.map_or_else(String::new, |size| format!(" of {size}"));
            sentences.extend(match (&self.totals, self.kept) {
                (Some(totals), _) if self.scores.is_some() => {
                    Some(format!("{} of {photos} became a field{size}.", totals.registered))
                }
                (Some(totals), _) => Some(format!("{} of {photos} have a camera.", totals.registered)),
                (None, Some(kept)) => Some(format!("{kept} of {photos} were kept.")),
                (None, None) => None,
            });
        }
        if let Some(awaited) = &self.awaited {
            sentences.push(format!("This is a draft, as `{awaited}` has no result yet."));
        }
        if let Some(scores) = &self.scores {
            sentences.push(format!(
                "New views differ from held-out photos by {} ({} dB).",
                gray_levels(scores.psnr),
                decibels(scores.psnr)
            ));
            sentences.extend(self.unseen_words(scores));
        }
        sentences.join(" ")
    }

    /// Says what the held-out photos show that no photo trained on saw. None for less than half a percent.
    fn unseen_words(&self, scores: &Scores) -> Option<String> {
        let share = self.invented_share.or_else(|| unseen_share(scores))?;
        let rest = if self.invented_share.is_some() {
            "of what they show: there the field is invented"
        } else {
            "of what they show from a similar direction: there the field guesses"
        };
        (share >= 0.005).then(|| format!("No photo trained on saw {} {rest}.", percent(share)))
    }

    fn figures(&self) -> Vec<Figure> {
        let of = |part: usize, whole: Option<usize>| match whole {
            Some(whole) => format!("{part} of {whole}"),
            None => part.to_string(),
        };
        let scores = self.scores.as_ref();
        let error = match &self.awaited {
            Some(_) => "error of new views, draft",
            None => "error of new views",
        };
        let all = [
            self.kept.map(|kept| ("photos kept", of(kept, self.found))),
            self.totals
                .as_ref()
                .map(|totals| ("photos placed", of(totals.registered, Some(totals.photos)))),
            scores.map(|scores| (error, gray_levels(scores.psnr))),
            scores
                .and_then(|scores| self.invented_share.or_else(|| unseen_share(scores)))
                .map(|share| ("unseen share", percent(share))),
            self.scene.as_ref().and_then(extent).map(|size| ("extent", size)),
        ];
        all.into_iter().flatten().collect()
    }

    /// Returns what to know, the weightiest first.
    fn notes(&self, page: &Page<'_>) -> Vec<Note> {
        let mut notes = Vec::new();
        let mut add = |applies: bool, text: String, section: &'static str| {
            if applies {
                notes.push(Note { text, section });
            }
        };
        for (node, sum) in page.judged() {
            let Ok(sum) = sum else { continue };
            let rejected = sum.seen - sum.kept;
            let text = format!(
                "{} rejected {rejected} of {}.",
                node.run.name,
                count(sum.seen, "photo")
            );
            add(2 * rejected > sum.seen, text, "rejected");
        }
        if let Some(totals) = &self.totals {
            let text = format!(
                "{} of {} have no camera.",
                totals.unplaced,
                count(totals.photos, "photo")
            );
            add(totals.unplaced > 0, text, "cameras");
        }
        if let Some(scores) = &self.scores {
            let judged = scores.views.len();
            let extrapolated = scores.apart.as_ref().map_or(0, |apart| apart.extrapolated);
            let text = format!(
                "{extrapolated} of {} look where no photo trained on does.",
                count(judged, "held-out photo")
            );
            add(extrapolated > 0, text, "heldout");
            let text = format!("The error is that of {} only.", count(judged, "held-out photo"));
            add(judged < FEW_HELD_OUT, text, "heldout");
        }
        if let Some(scene) = &self.scene {
            let text = "Up is not known: maps and orbits may be tilted.".to_owned();
            add(scene.up.is_none(), text, "cameras");
            let text = "The scene has no scale: lengths are in units of its own.".to_owned();
            add(scene.metres_per_unit.is_none(), text, "cameras");
        }
        let text = "Uncertainty was not measured: a `bootstrap` node maps it.".to_owned();
        add(
            self.scores.is_some() && !self.has_uncertainty,
            text,
            "uncertainty",
        );
        notes
    }
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

/// Returns a length with two significant digits, as nobody measures by an extent.
fn rounded(length: f64) -> String {
    let step = 10_f64.powf(length.abs().log10().floor() - 1.0);
    if step > 0.0 && step.is_finite() {
        number((length / step).round() * step)
    } else {
        number(0.0)
    }
}

/// Returns the root mean square error that belongs to a PSNR, for channels of 0 to 255: 255 / 10^(PSNR / 20).
fn gray_levels(psnr: f64) -> String {
    format!("{:.0} gray levels", 255.0 / 10_f64.powf(psnr / 20.0))
}

/// Returns the mean share of held-out photos that no photo trained on shows from within 30 degrees.
fn unseen_share(scores: &Scores) -> Option<f64> {
    let shares = scores
        .views
        .iter()
        .filter_map(|view| Some(view.nearest.as_ref()?.uncovered_share));
    let shares: Vec<f64> = shares.collect();
    (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64)
}

/// Returns the area on the ground that holds the sparse points but for stray ones, the longer side first. `None` where up is not known.
fn extent(scene: &Scene) -> Option<String> {
    scene.up?;
    let axes = Axes::new(scene);
    let side = |axis: Vec3| {
        let along = || scene.points.iter().map(|point| dot(point.position, axis));
        Some(quantile(along(), 1.0 - STRAY)? - quantile(along(), STRAY)?)
    };
    let (right, ahead) = (side(axes.right)?, side(axes.ahead)?);
    let words = |factor: f64, unit: &str| {
        let [long, short] = [right.max(ahead), right.min(ahead)].map(|side| rounded(side * factor));
        format!("{long} x {short} {unit}")
    };
    Some(match scene.metres_per_unit {
        Some(metres) => words(metres, "m"),
        None => words(1.0, "units"),
    })
}

#[cfg(test)]
mod tests {
    use marf_scene::Point;

    use super::*;
    use crate::fixture::{full, node};

    #[test]
    fn the_first_screen_says_the_result_with_its_numbers() {
        let (store, nodes) = full();
        let said = store.with_report(&nodes, |report| {
            let media = crate::media::Media::Embedded;
            body(&Page::new(report, &media)).into_string()
        });
        // 255 / 10^(24.567 / 20) = 15.08.
        for text in [
            "4 of 7 photos became a field",
            "New views differ from held-out photos by 15 gray levels (24.57 dB).",
            "No photo trained on saw 1 % of what they show: there the field is invented.",
            "<dt>photos kept</dt><dd>4 of 7</dd>",
            "<dt>photos placed</dt><dd>4 of 5</dd>",
            "1 of 5 photos have no camera.",
            "The error is that of 1 held-out photo only.",
            "<video",
        ] {
            assert!(said.contains(text), "{text}: {said}");
        }
    }

    #[test]
    fn a_run_that_made_nothing_says_nothing() {
        let store = crate::fixture::Store::default();
        let said = store.with_report(&[node("train", &[])], |report| {
            let media = crate::media::Media::Embedded;
            body(&Page::new(report, &media)).into_string()
        });
        assert!(
            !said.contains("<p class=\"lead\">") && !said.contains("<li>"),
            "{said}"
        );
    }

    /// 101 points on a line of 10 units that stand 2 m apart each tenth: 0.5 to 9.5 units are 18 m, and across there is nothing.
    #[test]
    fn an_extent_leaves_stray_points_out() {
        let scene = |up| Scene {
            up,
            metres_per_unit: Some(2.0),
            points: (0..=100)
                .map(|index| Point {
                    position: [f64::from(index) * 0.1, 0.0, 0.0],
                    color: None,
                    views: 2,
                })
                .collect(),
            ..Scene::default()
        };
        let found = extent(&scene(Some([0.0, 0.0, 1.0]))).unwrap();
        assert_eq!(found, "18 x 0 m");
        assert_eq!(
            [10.45, 8.039, 0.01234, 1234.0].map(rounded),
            ["10", "8", "0.012", "1,200"]
        );
        assert_eq!(extent(&scene(None)), None);
        assert_eq!(extent(&Scene::default()), None);
    }
}
