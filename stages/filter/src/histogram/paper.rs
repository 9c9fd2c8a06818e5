//! The paper's rule: bins of brightness that are too many standard deviations from the mean of the other photos.

use super::{Histogram, HistogramParams, UsualHistogram};
use crate::bytes::{put_number, take_number};
use crate::comparison::Pass;
use crate::decision::Decision;
use crate::filter::{MeasuredPhoto, Stored};
use crate::tones::ToneHistograms;

/// Bins of brightness.
const BINS: usize = 256;
/// Shares are counted in units of 2^-24, so that sums over photos are exact integers and do not depend on the order.
const SHARE: u64 = 1 << 24;

/// Sums over the photos of one instrument, exact.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsualBins {
    photos: u64,
    /// Of the share of each bin the sum and the sum of squares, in units of 1 / [`SHARE`] and of its square.
    sums: Vec<(u64, u128)>,
}

impl Default for UsualBins {
    fn default() -> Self {
        Self {
            photos: 0,
            sums: vec![(0, 0); BINS],
        }
    }
}

impl UsualBins {
    /// Adds a photo.
    fn count(&mut self, tones: &ToneHistograms<'_>) {
        self.photos += 1;
        for ((sum, squares), share) in self.sums.iter_mut().zip(normalised(tones)) {
            *sum += share;
            *squares += u128::from(share).pow(2);
        }
    }

    /// Adds other photos; `None` if there are more than can be counted.
    fn add(&mut self, other: &Self) -> Option<()> {
        self.photos = self.photos.checked_add(other.photos)?;
        for ((sum, squares), (more, more_squares)) in self.sums.iter_mut().zip(&other.sums) {
            *sum = sum.checked_add(*more)?;
            *squares = squares.checked_add(*more_squares)?;
        }
        Some(())
    }
}

/// The number of photos, then of each bin the sum and the upper and lower half of the sum of squares.
impl Stored<'_> for UsualBins {
    fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        put_number(&mut bytes, self.photos);
        for (sum, squares) in &self.sums {
            let numbers = [*sum, (squares >> 64) as u64, *squares as u64];
            numbers
                .into_iter()
                .for_each(|number| put_number(&mut bytes, number));
        }
        bytes
    }

    fn decode(mut bytes: &[u8]) -> Option<Self> {
        let mut number = || take_number(&mut bytes);
        let mut usual = Self {
            photos: number()?,
            ..Self::default()
        };
        for (sum, squares) in &mut usual.sums {
            *sum = number()?;
            *squares = u128::from(number()?) << 64 | u128::from(number()?);
        }
        bytes.is_empty().then_some(usual)
    }
}

/// Sums of the shares of the bins.
pub(super) struct SumsPass;

impl Pass<Histogram> for SumsPass {
    const NAME: &'static str = "sums";
    type Total = UsualBins;

    fn summarise<'a>(
        _: Option<&UsualHistogram>,
        photos: &[&MeasuredPhoto<'a, ToneHistograms<'a>>],
    ) -> Vec<u8> {
        let mut sums = UsualBins::default();
        photos.iter().for_each(|photo| sums.count(&photo.measure));
        sums.encode()
    }

    fn add(total: &mut UsualBins, summary: &[u8]) -> Option<()> {
        total.add(&UsualBins::decode(summary)?)
    }

    /// Fewer than three photos have no mean to be far from.
    fn conclude(_: &HistogramParams, _: Option<UsualHistogram>, total: UsualBins) -> Option<UsualHistogram> {
        (total.photos >= 3).then_some(UsualHistogram::Paper(total))
    }
}

/// Decides by the share of bins that are far from the mean of the other photos.
pub(super) fn decide(params: &HistogramParams, usual: &UsualBins, tones: &ToneHistograms<'_>) -> Decision {
    let others = usual.photos.saturating_sub(1) as f64;
    let bins = normalised(tones).zip(&usual.sums);
    let far = bins.filter(|(share, (sum, squares))| {
        let mean = sum.saturating_sub(*share) as f64 / others;
        let variance = squares.saturating_sub(u128::from(*share).pow(2)) as f64 / others - mean * mean;
        (*share as f64 - mean).abs() > params.sigmas * variance.max(0.0).sqrt()
    });
    decide_bins(far.count() as f64 / BINS as f64, params.max_bins)
}

/// Returns the bins of brightness as shares of all pixels, in units of 1 / [`SHARE`].
fn normalised(tones: &ToneHistograms<'_>) -> impl Iterator<Item = u64> {
    let all = tones.pixels().max(1);
    tones
        .counts()
        .take(BINS)
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
