//! First screen: what the run made in a sentence and five figures, a picture of it next to its cameras, and what to know.

use std::collections::BTreeSet;

use marf_numeric::quantile;
use marf_scene::Scene;
use marf_schema::scores::Scores;
use marf_schema::{bootstrap, calibrate, depth, output, train};
use marf_stage::Document;
use maud::{Markup, html};

use super::camera_view::Axes;
use super::cameras;
use super::format::{count, decibels};
use super::notes::{extrapolation_words, reach_words, rejected_words, unseen_share};
use super::page::Page;
use super::pictures;
use super::quality::{Figure, figures, percent, rounded};
use super::vector::{Vec3, dot};

/// Most things to know that are listed.
const MOST_NOTES: usize = 5;
/// The extent holds the sparse points between this quantile and its mirror, along each axis of the ground.
const STRAY: f64 = 0.05;
/// Fewer held-out photos than this say little about other views.
const FEW_HELD_OUT: usize = 5;
/// A smaller share of what photos show is not worth a word.
const LEAST_UNSEEN: f64 = 0.005;

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
    /// PSNR on photos trained on, if some were judged, dB.
    psnr_trained: Option<f64>,
    /// The last bootstrap, if it compared its maps with held-out photos.
    maps: Option<bootstrap::Metrics>,
    /// Median standard deviation of depths by pairs of photos, as a share of the depth.
    pairs_share: Option<f64>,
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
                figure {
                    (cameras::overview(scene))
                    figcaption { "cameras from above " (cameras::legend(scene)) }
                }
            }
        }
        @if !notes.is_empty() {
            ul.know {
                @for note in notes.iter().take(MOST_NOTES) {
                    li { (note.text) " " a href={ "#" (note.section) } { "Details" } }
                }
            }
        }
        @if facts.scores.is_some() && facts.awaited.is_none() {
            p.quiet {
                "Next: " code { "marf view" } " looks around and measures distances. " code { "marf export mesh --out scene.glb" }
                " is for headsets and engines, " code { "splats" } " for viewers of Gaussian splats, " code { "height" } " and "
                code { "orthophoto" } " for maps."
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
        let depth = page.with_document::<depth::Metrics>().last();
        let depth = depth.and_then(|node| page.document::<depth::Metrics>(node).ok());
        let trained = metrics.as_ref().and_then(|metrics| metrics.on_training.as_ref());
        Self {
            psnr_trained: trained.map(|trained| trained.psnr),
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
            maps: maps.filter(|metrics| metrics.heldout.is_some()),
            pairs_share: depth.and_then(|metrics| metrics.median_sigma_share),
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
            let size = size.map_or_else(String::new, |size| format!(" of {size} of ground"));
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
            let trained = self.psnr_trained.map_or_else(String::new, |psnr| {
                format!(", from photos trained on by {}", levels(psnr))
            });
            sentences.push(format!(
                "New views differ from held-out photos by {} of 255 gray levels (root mean square, {} dB){trained}.",
                levels(scores.psnr),
                decibels(scores.psnr)
            ));
            sentences.extend(self.unseen_words(scores));
        }
        sentences.join(" ")
    }

    /// Says how far depths are off: those of the field at sparse points of held-out photos, and those of pairs of photos.
    fn depth_words(&self) -> Option<String> {
        let has_scale = self.scene.as_ref()?.metres_per_unit.is_some();
        let held_out = self.maps.as_ref().and_then(|maps| maps.heldout.as_ref());
        let field = held_out
            .and_then(|held_out| held_out.depth_calibration.as_ref())
            .map(|depth| {
                let share = depth.median_error;
                let metres = has_scale.then(|| format!(" ({} cm at 5 m)", rounded(500.0 * share)));
                let share = format!("{} %{}", rounded(100.0 * share), metres.unwrap_or_default());
                format!(
                    "At sparse points of held-out photos, half of the retrainings' mean depths are off by at most {share}."
                )
            });
        let pairs = self.pairs_share.map(|share| {
            let share = rounded(100.0 * share);
            format!("One standard deviation of depths from pairs of photos is {share} % of the distance in the median.")
        });
        let sentences: Vec<String> = field.into_iter().chain(pairs).collect();
        (!sentences.is_empty()).then(|| sentences.join(" "))
    }

    /// Returns the viewpoints of the maps that are those of held-out photos.
    fn held_out_views(&self) -> Vec<&bootstrap::ViewReport> {
        let views = self.maps.iter().flat_map(|maps| &maps.views);
        views.filter(|view| view.photo.is_some()).collect()
    }

    /// Returns the mean share of what held-out photos show that no photo saw. `None` without maps of any.
    fn invented_share(&self) -> Option<f64> {
        let views = self.held_out_views();
        let sum: f64 = views.iter().map(|view| view.unseen_share).sum();
        (!views.is_empty()).then(|| sum / views.len() as f64)
    }

    /// Names the held-out photo that shows most of what no photo trained on saw. None of a single one.
    fn least_seen(&self) -> Option<String> {
        let views = self.held_out_views();
        let most = views
            .iter()
            .max_by(|a, b| a.unseen_share.total_cmp(&b.unseen_share))?;
        let is_some = views.len() > 1 && most.unseen_share >= LEAST_UNSEEN;
        is_some.then(|| {
            format!(
                "Invented areas are bright in the maps of what no photo saw. {} has most of them ({}).",
                most.name,
                percent(most.unseen_share)
            )
        })
    }

    /// Says what the held-out photos show that no photo trained on saw. None for less than half a percent.
    fn unseen_words(&self, scores: &Scores) -> Option<String> {
        let share = self.invented_share().or_else(|| unseen_share(scores))?;
        let rest = if self.invented_share().is_some() {
            "of what they show: there the field is invented"
        } else {
            "of what they show from a similar direction: there the field guesses"
        };
        (share >= LEAST_UNSEEN).then(|| format!("No photo trained on saw {} {rest}.", percent(share)))
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
            scores.map(|scores| (error, format!("{} of 255 gray levels", levels(scores.psnr)))),
            scores
                .and_then(|scores| self.invented_share().or_else(|| unseen_share(scores)))
                .map(|share| ("unseen share", percent(share))),
            self.scene
                .as_ref()
                .and_then(extent)
                .map(|size| ("ground with most points", size)),
        ];
        all.into_iter().flatten().collect()
    }

    /// Returns what to know, the weightiest first.
    fn notes(&self, page: &Page<'_>) -> Vec<Note> {
        let rejected = rejected_words(page);
        let are_most = self
            .found
            .zip(self.kept)
            .is_some_and(|(found, kept)| 2 * kept < found);
        let unplaced = self.totals.as_ref().filter(|totals| totals.unplaced > 0);
        let unplaced = unplaced.map(|totals| {
            let photos = count(totals.photos, "photo");
            format!("{} of {photos} have no camera.", totals.unplaced)
        });
        let scores = self.scores.as_ref();
        let scene = self.scene.as_ref();
        let is_tilted = scene.is_some_and(|scene| scene.up.is_none());
        let has_no_scale = scene.is_some_and(|scene| scene.metres_per_unit.is_none());
        let is_not_mapped = scores.is_some() && !self.has_uncertainty;
        let said = |applies: bool, text: &str| applies.then(|| text.to_owned());
        let all = [
            ("rejected", rejected.clone().filter(|_| are_most)),
            ("cameras", unplaced),
            ("heldout", scores.and_then(extrapolation_words)),
            ("heldout", scores.and_then(|scores| self.few_words(scores))),
            ("heldout", scores.and_then(reach_words)),
            (
                "cameras",
                said(is_tilted, "Up is not known: maps and orbits may be tilted."),
            ),
            (
                "cameras",
                said(
                    has_no_scale,
                    "The scene has no scale: lengths are in units of its own.",
                ),
            ),
            (
                "uncertainty",
                said(
                    is_not_mapped,
                    "Uncertainty was not measured: a `bootstrap` node maps it.",
                ),
            ),
            ("uncertainty", self.depth_words()),
            ("uncertainty", self.least_seen()),
            ("rejected", rejected.filter(|_| !are_most)),
        ];
        let notes = all.into_iter();
        let notes = notes.filter_map(|(section, text)| Some(Note { text: text?, section }));
        notes.collect()
    }

    /// Says of how few photos the error is. `None` of enough.
    fn few_words(&self, scores: &Scores) -> Option<String> {
        let judged = scores.views.len();
        let text = format!(
            "The error is that of {}{} only.",
            count(judged, "held-out photo"),
            self.places_words()
        );
        (judged < FEW_HELD_OUT).then_some(text)
    }

    /// Says at how many places the held-out photos were taken. Empty where that is not known.
    fn places_words(&self) -> String {
        let views = self.maps.iter().flat_map(|maps| &maps.views);
        let places: BTreeSet<u64> = views.filter_map(|view| view.place).collect();
        let words = (!places.is_empty()).then(|| format!(" at {}", count(places.len(), "place")));
        words.unwrap_or_default()
    }
}

/// Returns the root mean square error that belongs to a PSNR, for channels of 0 to 255: 255 / 10^(PSNR / 20).
fn levels(psnr: f64) -> String {
    format!("{:.0}", 255.0 / 10_f64.powf(psnr / 20.0))
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
mod tests;
