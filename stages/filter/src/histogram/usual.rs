//! What the photos of an instrument are compared with.

use super::params::HistogramParams;
use crate::bytes::{Stored, put_number, take_number};
use crate::statistics::Steps;
use crate::tones::{BINS, CHANNELS, ToneHistograms};

/// Bins of brightness.
pub(super) const BRIGHTNESS_BINS: usize = 256;

/// A kind of lost area.
pub(super) struct LostArea {
    /// Its share of the photo.
    pub(super) share: fn(&ToneHistograms<'_>) -> f64,
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
pub enum UsualHistogram {
    /// [`HistogramRule::Robust`].
    Robust(UsualTones),
    /// [`HistogramRule::Paper`].
    Paper(UsualBins),
}

/// A byte for the rule, then its own.
impl Stored<'_> for UsualHistogram {
    fn encode(&self) -> Vec<u8> {
        match self {
            Self::Robust(usual) => [vec![0], usual.encode()].concat(),
            Self::Paper(usual) => [vec![1], usual.encode()].concat(),
        }
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        match bytes.split_first()? {
            (0, usual) => UsualTones::decode(usual).map(Self::Robust),
            (1, usual) => UsualBins::decode(usual).map(Self::Paper),
            _ => None,
        }
    }
}

/// What the photos of one instrument are compared with, by the bins of the photo that is decided on, which is left out.
pub struct UsualTones {
    /// Upper quartile of each of [`LOST_AREAS`].
    pub(super) lost: [Steps; LOST_AREAS.len()],
    /// Median of the cumulative share of each bin of all channels.
    pub(super) medians: Vec<Steps>,
    /// Median and upper quartile of the distances of each channel, found in the second pass.
    pub(super) distances: Option<Box<[[Steps; 2]; CHANNELS.len()]>>,
}

/// The steps, one behind the other. Those of distances are absent after the first pass.
impl Stored<'_> for UsualTones {
    fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let distances = self
            .distances
            .iter()
            .flat_map(|distances| distances.as_flattened());
        let all = self.lost.iter().chain(&self.medians).chain(distances);
        all.for_each(|steps| steps.put(&mut bytes));
        bytes
    }

    fn decode(mut bytes: &[u8]) -> Option<Self> {
        let bytes = &mut bytes;
        let lost = [Steps::take(bytes)?, Steps::take(bytes)?];
        let medians: Option<Vec<Steps>> = (0..BINS).map(|_| Steps::take(bytes)).collect();
        let mut usual = Self {
            lost,
            medians: medians?,
            distances: None,
        };
        if !bytes.is_empty() {
            let mut pair = || Some([Steps::take(bytes)?, Steps::take(bytes)?]);
            usual.distances = Some(Box::new([pair()?, pair()?, pair()?]));
        }
        bytes.is_empty().then_some(usual)
    }
}

/// Sums over the photos of one instrument, exact.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsualBins {
    /// How many.
    pub(super) photos: u64,
    /// Of the share of each bin of brightness the sum and the sum of squares, in units of 2^-24 and of its square.
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
