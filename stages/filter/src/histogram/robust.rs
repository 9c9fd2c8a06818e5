//! The default rule: distances to the median histograms of the other photos, and lost areas.
//!
//! The first pass finds the medians of the cumulative shares of all bins and the quartiles of lost areas. The second
//! finds the medians and quartiles of the distances to these medians.

use serde::{Deserialize, Serialize};

use super::params::{Histogram, HistogramParams};
use super::usual::{LOST_AREAS, UsualHistogram, UsualTones};
use crate::bytes::read_list;
use crate::decision::Decision;
use crate::filter::{MeasuredPhoto, Pass};
use crate::statistics::{BinCounts, LogBins, Quantile, Steps, quantile_without};
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
#[derive(Serialize, Deserialize)]
pub(super) struct Shares {
    photos: u64,
    lost: [BinCounts; LOST_AREAS.len()],
    /// Photos by bin, then by share in steps of 1 / [`SHARE_STEPS`]: at most 4 MB.
    #[serde(deserialize_with = "read_list::<BINS, _, _>")]
    shares: Vec<BinCounts>,
}

impl Default for Shares {
    fn default() -> Self {
        Self {
            photos: 0,
            lost: Default::default(),
            shares: vec![BinCounts::default(); BINS],
        }
    }
}

impl Pass<Histogram> for SharesPass {
    const NAME: &'static str = "shares";
    type Total = Shares;

    fn summarise(_: Option<&UsualHistogram>, photos: &[&MeasuredPhoto<'_, ToneHistograms>]) -> Shares {
        let lost = LOST_AREAS.map(|area| {
            let shares = photos.iter().map(|photo| (area.share)(&photo.measure));
            BinCounts::new(shares.filter_map(|share| FINE.bin(share)))
        });
        let mut shares: Vec<_> = photos.iter().map(|photo| cumulative(&photo.measure)).collect();
        let by_bin = (0..BINS).map(|_| {
            let next = shares.iter_mut().filter_map(Iterator::next);
            BinCounts::new(next.map(|(_, share)| step_of(share)))
        });
        Shares {
            photos: photos.len() as u64,
            lost,
            shares: by_bin.collect(),
        }
    }

    fn add(total: &mut Shares, summary: Shares) -> Option<()> {
        total.photos = total.photos.checked_add(summary.photos)?;
        let totals = total.lost.iter_mut().chain(&mut total.shares);
        for (total, summary) in totals.zip(summary.lost.iter().chain(&summary.shares)) {
            total.add(summary)?;
        }
        Some(())
    }

    fn conclude(
        params: &HistogramParams,
        _: Option<UsualHistogram>,
        total: Shares,
    ) -> Option<UsualHistogram> {
        if total.photos < u64::from(params.min_set) {
            return None;
        }
        let median = |shares: &BinCounts| {
            quantile_without(shares.iter(), Quantile::MEDIAN, |step| {
                f64::from(step) / f64::from(SHARE_STEPS)
            })
        };
        let quartile = |lost: BinCounts| lost.quantile_without(Quantile::UPPER_QUARTILE, FINE);
        Some(UsualHistogram::Robust(UsualTones {
            lost: total.lost.map(quartile),
            medians: total.shares.iter().map(median).collect(),
            distances: None,
        }))
    }
}

/// The distributions of the distances to the median histograms.
pub(super) struct DistancesPass;

impl Pass<Histogram> for DistancesPass {
    const NAME: &'static str = "distances";
    type Total = [BinCounts; CHANNELS.len()];

    fn summarise(
        before: Option<&UsualHistogram>,
        photos: &[&MeasuredPhoto<'_, ToneHistograms>],
    ) -> Self::Total {
        let mut found = [const { Vec::new() }; CHANNELS.len()];
        if let Some(UsualHistogram::Robust(usual)) = before {
            for photo in photos {
                let distances = distances(&photo.measure, &usual.medians);
                for (found, distance) in found.iter_mut().zip(distances) {
                    found.extend(FINE.bin(distance));
                }
            }
        }
        found.map(|bins| BinCounts::new(bins.into_iter()))
    }

    fn add(total: &mut Self::Total, summary: Self::Total) -> Option<()> {
        for (total, summary) in total.iter_mut().zip(&summary) {
            total.add(summary)?;
        }
        Some(())
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
fn cumulative(tones: &ToneHistograms) -> impl Iterator<Item = (usize, f64)> {
    let all = tones.pixels().max(1) as f64;
    let channels = (0..).zip(CHANNELS);
    let bins = channels.flat_map(|(channel, (_, bins, _))| (0..bins).map(move |bin| (channel, bin)));
    let mut below = 0_u64;
    bins.zip(tones.counts()).map(move |((channel, bin), count)| {
        below = u64::from(*count) + if bin == 0 { 0 } else { below };
        (channel, below as f64 / all)
    })
}

/// Returns a share in steps of 1 / [`SHARE_STEPS`].
fn step_of(share: f64) -> u32 {
    (share * f64::from(SHARE_STEPS)).round() as u32
}

/// Returns the earth mover's distance of each channel to the median histogram of the other photos, in 8-bit steps. It
/// is the mean over all pixels of the steps they would have to move.
fn distances(tones: &ToneHistograms, medians: &[Steps]) -> [f64; CHANNELS.len()] {
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
    tones: &ToneHistograms,
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
    tones: &ToneHistograms,
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
