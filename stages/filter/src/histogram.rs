//! The filter `histogram`.

use marf_stage::{ParamError, Scope};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::filter::{Filter, MeasuredPhoto, check_range};
#[cfg(test)]
use crate::guard::Guard;
use crate::statistics::{MiddleValues, SortedValues, group_by_instrument};
use crate::tones::{CHANNELS, Counts, ToneHistograms, tones};

/// Rejects photos whose brightness or colours differ too much from those of the other photos, and photos with lost
/// areas.
pub struct Histogram;

/// The rule of [`Histogram`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HistogramRule {
    /// Distance to the median histograms of brightness and of two colour differences, compared with the distances of
    /// the other photos; and the shares of the photo that are flat, burnt out or black.
    Robust,
    /// The paper's rule: more than half of the bins of brightness are further than one standard deviation from
    /// the set's mean, the photo itself left out of both.
    Paper,
}

/// Parameters of [`Histogram`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HistogramParams {
    /// `robust` (default) or `paper`.
    pub rule: HistogramRule,
    /// Largest share of 8 x 8 blocks of one single brightness: areas lost in transmission, blocks, stripes. With
    /// `min_set` photos and more it is added to the upper quartile of the other photos of the instrument.
    pub max_flat: f64,
    /// Largest share of pixels without information: burnt out (a channel at 254 and more) or black (all at 4 and
    /// less). With `min_set` photos and more it is added to the upper quartile of the other photos of the instrument. Good photos of
    /// three cameras have 0.054 at most, a Navcam photo of burnt-out ground 0.40.
    pub max_clipped: f64,
    /// A distance of brightness to the median histogram up to this never rejects a photo, in 8-bit steps: a
    /// good Navcam photo in deep shadow is 67 away, an underexposed one of the demo 84, one of an eighth of the light 110.
    pub min_light: f64,
    /// The same for the two colour differences: colours of good photos differ by so much.
    pub min_distance: f64,
    /// Largest distance: the median of the others' distances plus this multiple of (upper quartile - median).
    pub spreads: f64,
    /// Fewest photos of one instrument that are compared with each other; of fewer, only `max_flat` and `max_clipped`
    /// reject.
    pub min_set: u32,
    /// Largest share of bins out of place, for `rule = "paper"`.
    pub max_bins: f64,
    /// How many standard deviations a bin may be off, for `rule = "paper"`.
    pub sigmas: f64,
    /// Photos kept or rejected by hand; filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for HistogramParams {
    fn default() -> Self {
        Self {
            rule: HistogramRule::Robust,
            max_flat: 0.2,
            max_clipped: 0.25,
            min_light: 75.0,
            min_distance: 24.0,
            spreads: 8.0,
            min_set: 5,
            max_bins: 0.5,
            sigmas: 1.0,
            by_hand: ByHand::default(),
        }
    }
}

impl Filter for Histogram {
    const NAME: &'static str = "histogram";
    const ABOUT: &'static str = "rejects photos whose brightness or colours do not belong to the set";
    const MEASURE_VERSION: u32 = 3;
    const DECISION_VERSION: u32 = 0;
    type Params = HistogramParams;
    type Measure<'a> = ToneHistograms<'a>;
    const MEASURE: Option<fn(&DecodedPhoto<'_>) -> ToneHistograms<'static>> = Some(tones);

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "3 655e1a5aa1ed",
        decisions: "3 e7fceec64855",
    };

    fn by_hand(params: &HistogramParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &HistogramParams) -> Result<(), ParamError> {
        check_range("max_flat", params.max_flat, 0.0, 1.0)?;
        check_range("max_clipped", params.max_clipped, 0.0, 1.0)?;
        check_range("min_light", params.min_light, 0.0, 512.0)?;
        check_range("min_distance", params.min_distance, 0.0, 512.0)?;
        check_range("spreads", params.spreads, 0.0, 1e6)?;
        check_range("max_bins", params.max_bins, 0.0, 1.0)?;
        check_range("sigmas", params.sigmas, 0.0, 1e6)
    }

    fn scope(_: &HistogramParams) -> Scope {
        Scope::Set
    }

    /// Decides on a set: of 1,000,000 photos the measures take some 0.6 GB, which are read once, and the decision 0.2 GB
    /// beside its answer.
    fn decide<'a>(
        params: &HistogramParams,
        photos: &[MeasuredPhoto<'a, ToneHistograms<'a>>],
    ) -> Vec<Decision> {
        let mut decisions = vec![Decision::pass(""); photos.len()];
        for group in group_by_instrument(photos) {
            let tones: Vec<&ToneHistograms<'_>> = group.iter().map(|index| &photos[*index].measure).collect();
            let decided = match params.rule {
                HistogramRule::Robust => robust(params, &tones),
                HistogramRule::Paper => paper(params, &tones),
            };
            for (index, decision) in group.into_iter().zip(decided) {
                decisions[index] = decision;
            }
        }
        decisions
    }
}

/// A kind of lost area: the share of the photo, its limit, and what a reason says of it.
type LostArea = (
    fn(&ToneHistograms<'_>) -> f64,
    fn(&HistogramParams) -> f64,
    &'static str,
);

/// The kinds of lost areas.
const LOST_AREAS: [LostArea; 2] = [
    (
        |tones| tones.flat_share(),
        |params| params.max_flat,
        "in blocks of one single brightness",
    ),
    (
        |tones| tones.clipped_share(),
        |params| params.max_clipped,
        "burnt out or black",
    ),
];

/// Decides on the photos of one instrument by the rule [`HistogramRule::Robust`]: for each photo, the decision whose
/// score is largest against its threshold.
fn robust(params: &HistogramParams, tones: &[&ToneHistograms<'_>]) -> Vec<Decision> {
    let set = tones.len() >= params.min_set as usize;
    let mut decisions: Vec<Option<Decision>> = vec![None; tones.len()];
    for (share, limit, what) in LOST_AREAS {
        let ranked = SortedValues::new(tones.iter().map(|tones| share(tones)).collect());
        for (decision, tones) in decisions.iter_mut().zip(tones) {
            let share = share(tones);
            let usual = if set {
                ranked.quantile_without(share, 3, 4)
            } else {
                0.0
            };
            *decision = Some(worse(
                decision.take(),
                decide_lost_area(share, limit(params) + usual, what),
            ));
        }
    }
    let floors = [params.min_light, params.min_distance, params.min_distance];
    // One pass over the counts: the bins of a channel follow those of the channel before it.
    let mut counts: Vec<Counts<'_>> = tones.iter().map(|tones| tones.counts()).collect();
    for ((name, bins, step), floor) in CHANNELS.into_iter().zip(floors).filter(|_| set) {
        let distances = distances(tones, &mut counts, bins, step);
        let ranked = SortedValues::new(distances.clone());
        for (decision, distance) in decisions.iter_mut().zip(distances) {
            let (median, quartile) = (
                ranked.quantile_without(distance, 1, 2),
                ranked.quantile_without(distance, 3, 4),
            );
            let limit = (median + params.spreads * (quartile - median)).max(floor);
            *decision = Some(worse(
                decision.take(),
                decide_distance(name, distance, median, limit),
            ));
        }
    }
    decisions.into_iter().flatten().collect()
}

/// Decides by the share of one kind of lost area.
fn decide_lost_area(share: f64, limit: f64, what: &str) -> Decision {
    if share > limit {
        let reason = format!(
            "{:.0} % of the photo {what}, at most {:.0} %",
            100.0 * share,
            100.0 * limit
        );
        return Decision::reject(share, limit, reason);
    }
    Decision::keep(share, limit)
}

/// Decides by the distance of one histogram to the median.
fn decide_distance(name: &str, distance: f64, usual: f64, limit: f64) -> Decision {
    if distance > limit {
        let reason = format!(
            "{name} is {distance:.0} steps from the set's median histogram, usual {usual:.0}, at most {limit:.0}"
        );
        return Decision::reject(distance, limit, reason);
    }
    Decision::keep(distance, limit)
}

/// Returns the decision whose score is the largest part of its threshold; the earlier one of equals.
fn worse(earlier: Option<Decision>, later: Decision) -> Decision {
    let part =
        |decision: &Decision| decision.score.unwrap_or(0.0) / decision.threshold.unwrap_or(1.0).max(1e-9);
    match earlier {
        Some(earlier) if part(&later) <= part(&earlier) => earlier,
        _ => later,
    }
}

/// Bins that are read at a time: as many counts of each photo as a line of the processor's cache holds.
const BINS_AT_ONCE: usize = 16;

/// Returns each photo's earth mover's distance to the median histogram of the others, in 8-bit steps: the mean over all
/// pixels of how far they would have to move. Reads the next `bins` of every photo, each of `step` 8-bit steps.
fn distances(tones: &[&ToneHistograms<'_>], counts: &mut [Counts<'_>], bins: usize, step: f64) -> Vec<f64> {
    let mut distances = vec![0.0; tones.len()];
    let mut below = vec![0_u64; tones.len()];
    let mut read = vec![[0_u32; BINS_AT_ONCE]; tones.len()];
    let (mut shares, mut order) = (vec![0.0; tones.len()], vec![0.0; tones.len()]);
    for first in (0..bins).step_by(BINS_AT_ONCE) {
        for (read, counts) in read.iter_mut().zip(&mut *counts) {
            read.iter_mut()
                .for_each(|count| *count = counts.next().unwrap_or(0));
        }
        let held = BINS_AT_ONCE.min(bins - first);
        for bin in 0..held {
            for (at, (below, read)) in below.iter_mut().zip(&read).enumerate() {
                *below += u64::from(read[bin]);
                shares[at] = *below as f64 / tones[at].pixels().max(1) as f64;
            }
            order.copy_from_slice(&shares);
            let middle = MiddleValues::of(&mut order);
            for (distance, share) in distances.iter_mut().zip(&shares) {
                *distance += step * (share - middle.median_without(*share)).abs();
            }
        }
    }
    distances
}

/// Shares are counted in units of 2^-24, so that sums over photos are exact integers and do not depend on the order.
const SHARE: u64 = 1 << 24;

/// Decides on the photos of one instrument by the rule [`HistogramRule::Paper`].
fn paper(params: &HistogramParams, tones: &[&ToneHistograms<'_>]) -> Vec<Decision> {
    if tones.len() < 3 {
        return vec![Decision::pass("fewer than 3 photos have no mean to be far from"); tones.len()];
    }
    let mut totals = [(0_u64, 0_u128); 256];
    for share in tones {
        for ((sum, squares), share) in totals.iter_mut().zip(normalised(share)) {
            *sum += share;
            *squares += u128::from(share).pow(2);
        }
    }
    let others = (tones.len() - 1) as f64;
    let far = |tones: &ToneHistograms<'_>| {
        let bins = normalised(tones).zip(&totals).filter(|(share, (sum, squares))| {
            let mean = (sum - share) as f64 / others;
            let variance = (squares - u128::from(*share).pow(2)) as f64 / others - mean * mean;
            (*share as f64 - mean).abs() > params.sigmas * variance.max(0.0).sqrt()
        });
        bins.count() as f64 / 256.0
    };
    tones
        .iter()
        .map(|tones| decide_bins(far(tones), params.max_bins))
        .collect()
}

/// Returns the bins of brightness as shares of all pixels, in units of 1 / [`SHARE`].
fn normalised(tones: &ToneHistograms<'_>) -> impl Iterator<Item = u64> {
    let all = tones.pixels().max(1);
    tones
        .counts()
        .take(256)
        .map(move |count| u64::from(count) * SHARE / all)
}

/// Decides by the share of bins out of place.
fn decide_bins(share: f64, limit: f64) -> Decision {
    if share > limit {
        let reason = format!(
            "{:.0} % of the bins out of place, at most {:.0} %",
            100.0 * share,
            100.0 * limit
        );
        return Decision::reject(share, limit, reason);
    }
    Decision::keep(share, limit)
}
