//! The paper's rule: bins of brightness that are too many standard deviations from the mean of the other photos.

use super::params::{Histogram, HistogramParams};
use super::usual::{BRIGHTNESS_BINS, UsualBins, UsualHistogram};
use crate::decision::Decision;
use crate::filter::{MeasuredPhoto, Pass};
use crate::tones::ToneHistograms;

/// Shares are counted in units of 2^-24, so that sums over photos are exact integers and do not depend on the order.
const SHARE: u64 = 1 << 24;

/// Sums of the shares of the bins.
pub(super) struct SumsPass;

impl Pass<Histogram> for SumsPass {
    const NAME: &'static str = "sums";
    type Total = UsualBins;

    fn summarise(_: Option<&UsualHistogram>, photos: &[&MeasuredPhoto<'_, ToneHistograms>]) -> UsualBins {
        let mut sums = UsualBins::default();
        photos
            .iter()
            .for_each(|photo| sums.count(normalised(&photo.measure)));
        sums
    }

    fn add(total: &mut UsualBins, summary: UsualBins) -> Option<()> {
        total.add(&summary)
    }

    /// Fewer than three photos have no mean to be far from.
    fn conclude(_: &HistogramParams, _: Option<UsualHistogram>, total: UsualBins) -> Option<UsualHistogram> {
        (total.photos >= 3).then_some(UsualHistogram::Paper(total))
    }
}

/// Decides by the share of bins that are far from the mean of the other photos.
pub(super) fn decide(params: &HistogramParams, usual: &UsualBins, tones: &ToneHistograms) -> Decision {
    let others = usual.photos.saturating_sub(1) as f64;
    let bins = normalised(tones).zip(&usual.sums);
    let far = bins.filter(|(share, (sum, squares))| {
        let mean = sum.saturating_sub(*share) as f64 / others;
        let variance = squares.saturating_sub(u128::from(*share).pow(2)) as f64 / others - mean * mean;
        (*share as f64 - mean).abs() > params.sigmas * variance.max(0.0).sqrt()
    });
    decide_bins(far.count() as f64 / BRIGHTNESS_BINS as f64, params.max_bins)
}

/// Returns the bins of brightness as shares of all pixels, in units of 1 / [`SHARE`].
fn normalised(tones: &ToneHistograms) -> impl Iterator<Item = u64> {
    let all = tones.pixels().max(1);
    tones.counts()[..BRIGHTNESS_BINS]
        .iter()
        .map(move |count| u64::from(*count) * SHARE / all)
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
