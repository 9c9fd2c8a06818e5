//! What the photos of an instrument are compared with.

use serde::{Deserialize, Serialize};

use super::params::HistogramParams;
use crate::bytes::read_list;
use crate::statistics::Steps;
use crate::tones::{BINS, CHANNELS, ToneHistograms};

/// Bins of brightness.
pub(super) const BRIGHTNESS_BINS: usize = 256;

/// A kind of lost area.
pub(super) struct LostArea {
    /// Its share of the photo.
    pub(super) share: fn(&ToneHistograms) -> f64,
    /// The largest share that is kept.
    pub(super) limit: fn(&HistogramParams) -> f64,
    /// What a reason says of it.
    pub(super) about: &'static str,
}

/// The kinds of lost areas.
pub(super) const LOST_AREAS: [LostArea; 2] = [
    LostArea {
        share: |tones| tones.flat_share(),
        limit: |params| params.max_flat,
        about: "in blocks of one single brightness",
    },
    LostArea {
        share: |tones| tones.clipped_share(),
        limit: |params| params.max_clipped,
        about: "burnt out or black",
    },
];

/// What the photos of an instrument are compared with, by the rule.
#[derive(Serialize, Deserialize)]
pub enum UsualHistogram {
    /// [`HistogramRule::Robust`].
    Robust(UsualTones),
    /// [`HistogramRule::Paper`].
    Paper(UsualBins),
}

/// What the photos of one instrument are compared with, by the bins of the photo that is decided on, which is left out.
#[derive(Serialize, Deserialize)]
pub struct UsualTones {
    /// Upper quartile of each of [`LOST_AREAS`].
    pub(super) lost: [Steps; LOST_AREAS.len()],
    /// Median of the cumulative share of each bin of all channels.
    #[serde(deserialize_with = "read_list::<BINS, _, _>")]
    pub(super) medians: Vec<Steps>,
    /// Median and upper quartile of the distances of each channel, found in the second pass.
    pub(super) distances: Option<Box<[[Steps; 2]; CHANNELS.len()]>>,
}

/// Sums over the photos of one instrument, exact.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UsualBins {
    /// How many.
    pub(super) photos: u64,
    /// Of the share of each bin of brightness the sum and the sum of squares, in units of 2^-24 and of its square.
    #[serde(deserialize_with = "read_list::<BRIGHTNESS_BINS, _, _>")]
    pub(super) sums: Vec<(u64, u128)>,
}

impl Default for UsualBins {
    fn default() -> Self {
        Self {
            photos: 0,
            sums: vec![(0, 0); BRIGHTNESS_BINS],
        }
    }
}

impl UsualBins {
    /// Adds a photo by the shares of its bins.
    pub(super) fn count(&mut self, shares: impl Iterator<Item = u64>) {
        self.photos += 1;
        for ((sum, squares), share) in self.sums.iter_mut().zip(shares) {
            *sum += share;
            *squares += u128::from(share).pow(2);
        }
    }

    /// Adds other photos. `None` if there are more than can be counted.
    pub(super) fn add(&mut self, other: &Self) -> Option<()> {
        self.photos = self.photos.checked_add(other.photos)?;
        for ((sum, squares), (more, more_squares)) in self.sums.iter_mut().zip(&other.sums) {
            *sum = sum.checked_add(*more)?;
            *squares = squares.checked_add(*more_squares)?;
        }
        Some(())
    }
}
