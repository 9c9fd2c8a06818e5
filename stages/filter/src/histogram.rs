//! The filter `histogram`.

use marf_cache::ContentHash;
use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::filter::{Filter, MeasuredPhoto, check_range};
#[cfg(test)]
use crate::guard::Guard;
use crate::luma::{Luma, luma};
use crate::statistics::{SortedValues, group_by_instrument};

/// Rejects photos whose brightness or colours differ too much from those of the other photos, and photos with lost
/// areas.
pub struct Histogram;

/// The rule of [`Histogram`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ContentHash)]
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
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema, ContentHash)]
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

/// Histograms of brightness and colour differences of a photo, and counts of its lost areas.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ToneHistograms {
    /// Pixels of a sample by brightness, 256 bins of 1 step.
    luma: Vec<u32>,
    /// Pixels by red - green + 256, 128 bins of 4 steps.
    red_green: Vec<u32>,
    /// Pixels by blue - green + 256, 128 bins of 4 steps.
    blue_green: Vec<u32>,
    /// Whole 8 x 8 blocks, counted from the top left corner.
    blocks: u32,
    /// Blocks of one single brightness.
    flat_blocks: u32,
    /// Pixels of the sample that are burnt out or black.
    clipped: u32,
}

/// Pixels a side of a block.
const BLOCK: usize = 8;
/// A channel at this value or above is burnt out.
const BURNT: u8 = 254;
/// A pixel is black if no channel is above this.
const BLACK: u8 = 4;
/// Name of each histogram, and width of its bins in 8-bit steps.
const CHANNELS: [(&str, f64); 3] = [("brightness", 1.0), ("red - green", 4.0), ("blue - green", 4.0)];

impl Filter for Histogram {
    const NAME: &'static str = "histogram";
    const ABOUT: &'static str = "rejects photos whose brightness or colours do not belong to the set";
    const MEASURE_VERSION: u32 = 2;
    const DECISION_VERSION: u32 = 0;
    type Params = HistogramParams;
    type Measure = ToneHistograms;
    const MEASURE: Option<fn(&DecodedPhoto) -> ToneHistograms> = Some(tones);

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "2 b666ddc40224",
        decisions: "2 e7fceec64855",
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

    fn decide(params: &HistogramParams, photos: &[MeasuredPhoto<ToneHistograms>]) -> Vec<Decision> {
        let mut decisions = vec![Decision::pass(""); photos.len()];
        for group in group_by_instrument(photos) {
            let tones: Vec<&ToneHistograms> = group.iter().map(|index| &photos[*index].measure).collect();
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

/// Measures the histograms of a photo.
fn tones(decoded: &DecodedPhoto) -> ToneHistograms {
    let mut tones = ToneHistograms {
        luma: vec![0; 256],
        red_green: vec![0; 128],
        blue_green: vec![0; 128],
        blocks: ((decoded.luma.width / BLOCK) * (decoded.luma.height / BLOCK)) as u32,
        flat_blocks: flat_blocks(&decoded.luma),
        clipped: 0,
    };
    for pixel in decoded.sample() {
        let [red, green, blue] = pixel;
        let difference = |channel: u8| (256 + usize::from(channel) - usize::from(green)) / 4;
        let most = red.max(green).max(blue);
        tones.clipped += u32::from(!(BLACK + 1..BURNT).contains(&most));
        tones.luma[usize::from(luma(pixel))] += 1;
        tones.red_green[difference(red)] += 1;
        tones.blue_green[difference(blue)] += 1;
    }
    tones
}

/// Counts the blocks of one single brightness.
fn flat_blocks(luma: &Luma) -> u32 {
    let mut flat = 0;
    for rows in luma.values.chunks_exact((BLOCK * luma.width).max(1)) {
        for left in (0..(luma.width / BLOCK) * BLOCK).step_by(BLOCK) {
            let first = rows[left];
            let mut lines = rows.chunks_exact(luma.width).map(|row| &row[left..left + BLOCK]);
            flat += u32::from(lines.all(|line| line.iter().all(|value| *value == first)));
        }
    }
    flat
}

impl ToneHistograms {
    /// Returns the share of blocks of one single brightness, in [0, 1].
    fn flat_share(&self) -> f64 {
        f64::from(self.flat_blocks) / f64::from(self.blocks.max(1))
    }

    /// Returns the share of pixels that are burnt out or black, in [0, 1].
    fn clipped_share(&self) -> f64 {
        let all: u64 = self.luma.iter().map(|count| u64::from(*count)).sum();
        f64::from(self.clipped) / all.max(1) as f64
    }

    /// Returns a histogram by its index in [`CHANNELS`].
    fn channel(&self, channel: usize) -> &[u32] {
        [&self.luma, &self.red_green, &self.blue_green][channel]
    }

    /// Returns the cumulative histogram of a channel: the share of pixels in each bin or below, in [0, 1].
    fn cumulative(&self, channel: usize) -> Vec<f64> {
        let bins = self.channel(channel);
        let all: u64 = bins.iter().map(|count| u64::from(*count)).sum();
        let mut below = 0_u64;
        let shares = bins.iter().map(|count| {
            below += u64::from(*count);
            below as f64 / all.max(1) as f64
        });
        shares.collect()
    }
}

/// A kind of lost area: the share of the photo, its limit, and what a reason says of it.
type LostArea = (
    fn(&ToneHistograms) -> f64,
    fn(&HistogramParams) -> f64,
    &'static str,
);

/// The kinds of lost areas.
const LOST_AREAS: [LostArea; 2] = [
    (
        ToneHistograms::flat_share,
        |params| params.max_flat,
        "in blocks of one single brightness",
    ),
    (
        ToneHistograms::clipped_share,
        |params| params.max_clipped,
        "burnt out or black",
    ),
];

/// Decides on the photos of one instrument by the rule [`HistogramRule::Robust`]: for each photo, the decision whose
/// score is largest against its threshold.
fn robust(params: &HistogramParams, tones: &[&ToneHistograms]) -> Vec<Decision> {
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
    for (channel, (name, step)) in CHANNELS.iter().enumerate().filter(|_| set) {
        let distances = distances(tones, channel, *step);
        let ranked = SortedValues::new(distances.clone());
        for (decision, distance) in decisions.iter_mut().zip(distances) {
            let (median, quartile) = (
                ranked.quantile_without(distance, 1, 2),
                ranked.quantile_without(distance, 3, 4),
            );
            let limit = (median + params.spreads * (quartile - median)).max(floors[channel]);
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

/// Returns each photo's earth mover's distance to the median histogram of the others, in 8-bit steps: the mean over all
/// pixels of how far they would have to move.
fn distances(tones: &[&ToneHistograms], channel: usize, step: f64) -> Vec<f64> {
    let shares: Vec<Vec<f64>> = tones.iter().map(|tones| tones.cumulative(channel)).collect();
    let mut distances = vec![0.0; tones.len()];
    for bin in 0..tones.first().map_or(0, |tones| tones.channel(channel).len()) {
        let ranked = SortedValues::new(shares.iter().map(|shares| shares[bin]).collect());
        for (distance, shares) in distances.iter_mut().zip(&shares) {
            *distance += step * (shares[bin] - ranked.quantile_without(shares[bin], 1, 2)).abs();
        }
    }
    distances
}

/// Shares are counted in units of 2^-24, so that sums over photos are exact integers and do not depend on the order.
const SHARE: u64 = 1 << 24;

/// Decides on the photos of one instrument by the rule [`HistogramRule::Paper`].
fn paper(params: &HistogramParams, tones: &[&ToneHistograms]) -> Vec<Decision> {
    if tones.len() < 3 {
        return vec![Decision::pass("fewer than 3 photos have no mean to be far from"); tones.len()];
    }
    let shares: Vec<Vec<u64>> = tones.iter().map(|tones| normalised(&tones.luma)).collect();
    let sum = |bin: usize| shares.iter().map(|shares| shares[bin]).sum::<u64>();
    let squares = |bin: usize| {
        shares
            .iter()
            .map(|shares| u128::from(shares[bin]).pow(2))
            .sum::<u128>()
    };
    let totals: Vec<(u64, u128)> = (0..256).map(|bin| (sum(bin), squares(bin))).collect();
    let others = (tones.len() - 1) as f64;
    let far = |shares: &[u64]| {
        let bins = shares.iter().zip(&totals).filter(|(share, (sum, squares))| {
            let mean = (sum - **share) as f64 / others;
            let variance = (squares - u128::from(**share).pow(2)) as f64 / others - mean * mean;
            (**share as f64 - mean).abs() > params.sigmas * variance.max(0.0).sqrt()
        });
        bins.count() as f64 / 256.0
    };
    shares
        .iter()
        .map(|shares| decide_bins(far(shares), params.max_bins))
        .collect()
}

/// Returns the bins as shares of all pixels, in units of 1 / [`SHARE`].
fn normalised(bins: &[u32]) -> Vec<u64> {
    let all: u64 = bins.iter().map(|count| u64::from(*count)).sum();
    bins.iter()
        .map(|count| u64::from(*count) * SHARE / all.max(1))
        .collect()
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
