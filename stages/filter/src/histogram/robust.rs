//! The default rule: distances to the median histograms of the other photos, and lost areas.
//!
//! The first pass finds the medians of the cumulative shares of all bins and the quartiles of lost areas. The second
//! finds the medians and quartiles of the distances to these medians.

use super::params::{Histogram, HistogramParams};
use super::usual::{LOST_AREAS, UsualHistogram, UsualTones};
use crate::bytes::{put_number, take_number};
use crate::decision::Decision;
use crate::filter::{MeasuredPhoto, Pass};
use crate::statistics::{BinCounts, LogBins, Quantile, Steps, put_bins, quantile_without, take_bins};
use crate::tones::{BINS, CHANNELS, ToneHistograms};

/// Cumulative shares are counted in steps of 1 / 1,024: a distance, a sum over 256 bins, is an eighth of an 8-bit step off at the
/// most. Limits are 24 steps at the least.
const SHARE_STEPS: u32 = 1024;
/// Bins of distances and of lost areas, at most 0.1 % wide. The limit of a distance is the median plus a multiple of
/// (upper quartile - median), which enlarges a small error of both.
const FINE: LogBins = LogBins { bits: 10 };

/// The distributions of lost areas and of the cumulative shares of all bins.
pub(super) struct SharesPass;

/// What [`SharesPass`] counts.
pub(super) struct Shares {
    photos: u64,
    lost: [BinCounts; LOST_AREAS.len()],
    /// Photos by bin, then by share, 2 MB.
    shares: Vec<[u32; SHARE_STEPS as usize + 1]>,
}

impl Default for Shares {
    fn default() -> Self {
        Self {
            photos: 0,
            lost: Default::default(),
            shares: vec![[0; SHARE_STEPS as usize + 1]; BINS],
        }
    }
}

impl Pass<Histogram> for SharesPass {
    const NAME: &'static str = "shares";
    type Total = Shares;

    /// The number of photos, each kind of lost area, the cumulative share of each bin.
    fn summarise<'a>(
        _: Option<&UsualHistogram>,
        photos: &[&MeasuredPhoto<'a, ToneHistograms<'a>>],
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        put_number(&mut bytes, photos.len() as u64);
        for area in LOST_AREAS {
            let shares = photos
                .iter()
                .filter_map(|photo| FINE.bin((area.share)(&photo.measure)));
            put_bins(&mut bytes, shares.collect());
        }
        let mut shares: Vec<_> = photos.iter().map(|photo| cumulative(&photo.measure)).collect();
        for _ in 0..BINS {
            let next = shares.iter_mut().filter_map(Iterator::next);
            put_bins(&mut bytes, next.map(|(_, share)| step_of(share)).collect());
        }
        bytes
    }

    fn add(total: &mut Shares, mut summary: &[u8]) -> Option<()> {
        total.photos = total.photos.checked_add(take_number(&mut summary)?)?;
        for lost in &mut total.lost {
            lost.take(&mut summary)?;
        }
        for shares in &mut total.shares {
            take_bins(&mut summary, |step, count| {
                let photos = shares.get_mut(step as usize)?;
                *photos = photos.checked_add(u32::try_from(count).ok()?)?;
                Some(())
            })?;
        }
        summary.is_empty().then_some(())
    }

    fn conclude(
        params: &HistogramParams,
        _: Option<UsualHistogram>,
        total: Shares,
    ) -> Option<UsualHistogram> {
        if total.photos < u64::from(params.min_set) {
            return None;
        }
        let median = |shares: &[u32]| {
            let counts = (0..).zip(shares).filter(|(_, photos)| **photos > 0);
            let counts = counts.map(|(step, photos)| (step, u64::from(*photos)));
            quantile_without(counts, Quantile::MEDIAN, |step| {
                f64::from(step) / f64::from(SHARE_STEPS)
            })
        };
        let quartile = |lost: BinCounts| lost.quantile_without(Quantile::UPPER_QUARTILE, FINE);
        Some(UsualHistogram::Robust(UsualTones {
            lost: total.lost.map(quartile),
            medians: total.shares.iter().map(|shares| median(shares)).collect(),
            distances: None,
        }))
    }
}

/// The distributions of the distances to the median histograms.
pub(super) struct DistancesPass;

impl Pass<Histogram> for DistancesPass {
    const NAME: &'static str = "distances";
    type Total = [BinCounts; CHANNELS.len()];

    /// The distances of each channel.
    fn summarise<'a>(
        before: Option<&UsualHistogram>,
        photos: &[&MeasuredPhoto<'a, ToneHistograms<'a>>],
    ) -> Vec<u8> {
        let mut found = [const { Vec::new() }; CHANNELS.len()];
        if let Some(UsualHistogram::Robust(usual)) = before {
            for photo in photos {
                let distances = distances(&photo.measure, &usual.medians);
                for (found, distance) in found.iter_mut().zip(distances) {
                    found.extend(FINE.bin(distance));
                }
            }
        }
        let mut bytes = Vec::new();
        found.into_iter().for_each(|bins| put_bins(&mut bytes, bins));
        bytes
    }

    fn add(total: &mut Self::Total, mut summary: &[u8]) -> Option<()> {
        for counts in total {
            counts.take(&mut summary)?;
        }
        summary.is_empty().then_some(())
    }

    fn conclude(
        _: &HistogramParams,
        before: Option<UsualHistogram>,
        total: Self::Total,
    ) -> Option<UsualHistogram> {
        let Some(UsualHistogram::Robust(usual)) = before else {
            return None;
        };
        let quantiles = |counts: BinCounts| {
            [Quantile::MEDIAN, Quantile::UPPER_QUARTILE]
                .map(|quantile| counts.quantile_without(quantile, FINE))
        };
        Some(UsualHistogram::Robust(UsualTones {
            distances: Some(Box::new(total.map(quantiles))),
            ..usual
        }))
    }
}

/// Returns the channel of each bin and the share of the pixels that are in it or in a lower bin of the channel, in [0, 1].
fn cumulative(tones: &ToneHistograms<'_>) -> impl Iterator<Item = (usize, f64)> {
    let all = tones.pixels().max(1) as f64;
    let channels = (0..).zip(CHANNELS);
    let bins = channels.flat_map(|(channel, (_, bins, _))| (0..bins).map(move |bin| (channel, bin)));
    let mut below = 0_u64;
    bins.zip(tones.counts()).map(move |((channel, bin), count)| {
        below = u64::from(count) + if bin == 0 { 0 } else { below };
        (channel, below as f64 / all)
    })
}

/// Returns a share in steps of 1 / [`SHARE_STEPS`].
fn step_of(share: f64) -> u32 {
    (share * f64::from(SHARE_STEPS)).round() as u32
}

/// Returns the earth mover's distance of each channel to the median histogram of the other photos, in 8-bit steps. It
/// is the mean over all pixels of the steps they would have to move.
fn distances(tones: &ToneHistograms<'_>, medians: &[Steps]) -> [f64; CHANNELS.len()] {
    let mut distances = [0.0; CHANNELS.len()];
    for ((channel, share), median) in cumulative(tones).zip(medians) {
        let (_, _, width) = CHANNELS[channel];
        distances[channel] += width * (share - median.at(Some(step_of(share)))).abs();
    }
    distances
}

/// Returns, of the decisions on lost areas and on distances, that whose score is largest against its threshold.
pub(super) fn decide(
    params: &HistogramParams,
    usual: Option<&UsualTones>,
    tones: &ToneHistograms<'_>,
) -> Decision {
    let lost = LOST_AREAS.iter().enumerate().map(|(at, area)| {
        let share = (area.share)(tones);
        let usual = usual.map_or(0.0, |usual| usual.lost[at].at(FINE.bin(share)));
        decide_lost_area(share, (area.limit)(params) + usual, area.about)
    });
    let distances = usual.and_then(|usual| decide_distances(params, usual, tones));
    let all = lost.chain(distances.into_iter().flatten());
    all.reduce(worse).unwrap_or_else(|| Decision::pass(""))
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

/// Decides by the distance of each channel.
fn decide_distances(
    params: &HistogramParams,
    usual: &UsualTones,
    tones: &ToneHistograms<'_>,
) -> Option<[Decision; CHANNELS.len()]> {
    let quantiles = usual.distances.as_ref()?;
    let found = distances(tones, &usual.medians);
    let floors = [params.min_light, params.min_distance, params.min_distance];
    Some(std::array::from_fn(|channel| {
        let distance = found[channel];
        let [median, quartile] = quantiles[channel].map(|quantile| quantile.at(FINE.bin(distance)));
        let limit = (median + params.spreads * (quartile - median)).max(floors[channel]);
        decide_distance(CHANNELS[channel].0, distance, median, limit)
    }))
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

/// Returns the decision whose score is the largest part of its threshold, the earlier one on ties.
fn worse(earlier: Decision, later: Decision) -> Decision {
    let part =
        |decision: &Decision| decision.score.unwrap_or(0.0) / decision.threshold.unwrap_or(1.0).max(1e-9);
    if part(&later) <= part(&earlier) {
        earlier
    } else {
        later
    }
}
