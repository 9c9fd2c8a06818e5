//! The tones of a photo: histograms of brightness and colour differences, and counts of its lost areas.

use std::borrow::Cow;

use crate::bytes::{Stored, put_number, take_number};
use crate::decoded::DecodedPhoto;
use crate::luma::{Luma, luma};

/// Pixels a side of a block.
const BLOCK: usize = 8;
/// A channel at this value or above is burnt out.
const BURNT: u8 = 254;
/// A pixel is black if no channel is above this.
const BLACK: u8 = 4;
/// Name of each histogram, its number of bins, and their width in 8-bit steps: brightness, red - green + 256 and
/// blue - green + 256.
pub(crate) const CHANNELS: [(&str, usize, f64); 3] = [
    ("brightness", 256, 1.0),
    ("red - green", 128, 4.0),
    ("blue - green", 128, 4.0),
];
/// Bins of all histograms.
pub(crate) const BINS: usize = 512;

/// Histograms of brightness and colour differences of a photo, and counts of its lost areas. The counts stay as they are
/// kept, some 0.6 KB a photo.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ToneHistograms<'a> {
    /// Whole 8 x 8 blocks, counted from the top left corner.
    blocks: u32,
    /// Blocks of one single brightness.
    flat_blocks: u32,
    /// Pixels of the sample that are burnt out or black.
    clipped: u32,
    /// Pixels of the sample.
    pixels: u64,
    /// The counts of all bins, channel by channel: each a number, behind a 0 the length of the run of zeros less 1.
    counts: Cow<'a, [u8]>,
}

impl<'a> ToneHistograms<'a> {
    /// Returns the share of blocks of one single brightness, in [0, 1].
    pub(crate) fn flat_share(&self) -> f64 {
        f64::from(self.flat_blocks) / f64::from(self.blocks.max(1))
    }

    /// Returns the share of pixels that are burnt out or black, in [0, 1].
    pub(crate) fn clipped_share(&self) -> f64 {
        f64::from(self.clipped) / self.pixels.max(1) as f64
    }

    /// Returns the number of pixels that were counted, the sum of each histogram.
    pub(crate) fn pixels(&self) -> u64 {
        self.pixels
    }

    /// Returns the counts of all bins, channel by channel.
    pub(crate) fn counts(&self) -> Counts<'_> {
        Counts {
            bytes: &self.counts,
            zeros: 0,
        }
    }
}

/// The counts of the bins, read one by one.
pub(crate) struct Counts<'a> {
    bytes: &'a [u8],
    /// Zeros still to come.
    zeros: u64,
}

impl Iterator for Counts<'_> {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        if self.zeros > 0 {
            self.zeros -= 1;
            return Some(0);
        }
        let count = u32::try_from(take_number(&mut self.bytes)?).ok()?;
        if count == 0 {
            self.zeros = take_number(&mut self.bytes)?;
        }
        Some(count)
    }
}

/// Three numbers, then the counts.
impl<'a> Stored<'a> for ToneHistograms<'a> {
    fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for number in [self.blocks, self.flat_blocks, self.clipped] {
            put_number(&mut bytes, u64::from(number));
        }
        bytes.extend(&*self.counts);
        bytes
    }

    fn decode(mut bytes: &'a [u8]) -> Option<Self> {
        let mut number = || u32::try_from(take_number(&mut bytes)?).ok();
        let (blocks, flat_blocks, clipped) = (number()?, number()?, number()?);
        let mut tones = Self {
            blocks,
            flat_blocks,
            clipped,
            pixels: 0,
            counts: Cow::Borrowed(bytes),
        };
        let mut counts = Counts { bytes, zeros: 0 };
        let sums = CHANNELS.map(|(_, bins, _)| {
            let sum = (0..bins)
                .map(|_| counts.next().map(u64::from))
                .sum::<Option<u64>>();
            sum.unwrap_or(u64::MAX)
        });
        tones.pixels = sums[0];
        let whole = counts.bytes.is_empty() && counts.zeros == 0 && !sums.contains(&u64::MAX);
        (whole && sums.iter().all(|sum| *sum == tones.pixels)).then_some(tones)
    }
}

/// Measures the tones of a photo.
pub(crate) fn tones(decoded: &DecodedPhoto<'_>) -> ToneHistograms<'static> {
    // Neighbours are often in the same bin, and a count must be written before it can be read again: hence two of each.
    let mut pairs = [[0_u32; 2]; BINS];
    let (mut clipped, mut pixels) = (0, 0);
    for (at, pixel) in decoded.sample().enumerate() {
        let [red, green, blue] = pixel;
        let difference = |channel: u8| (256 + usize::from(channel) - usize::from(green)) / 4;
        let most = red.max(green).max(blue);
        clipped += u32::from(!(BLACK + 1..BURNT).contains(&most));
        pairs[usize::from(luma(pixel))][at % 2] += 1;
        pairs[256 + difference(red)][at % 2] += 1;
        pairs[384 + difference(blue)][at % 2] += 1;
        pixels += 1;
    }
    let bins = pairs.map(|pair| pair[0] + pair[1]);
    let luma = decoded.luma();
    ToneHistograms {
        blocks: ((luma.width / BLOCK) * (luma.height / BLOCK)) as u32,
        flat_blocks: flat_blocks(luma),
        clipped,
        pixels,
        counts: Cow::Owned(encode_counts(&bins)),
    }
}

/// Writes the counts of the bins, with the length of each run of zeros.
fn encode_counts(bins: &[u32]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for run in bins.chunk_by(|a, b| *a == 0 && *b == 0) {
        put_number(&mut bytes, u64::from(run[0]));
        if run[0] == 0 {
            put_number(&mut bytes, run.len() as u64 - 1);
        }
    }
    bytes
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

#[cfg(test)]
mod tests {
    use marf_scene::{Image, Photo};

    use super::*;

    /// By hand: a run of three zeros is a 0 and a 2.
    #[test]
    fn runs_of_zeros_take_two_bytes() {
        assert_eq!(encode_counts(&[5, 0, 0, 0, 300, 0]), [5, 0, 2, 0xac, 2, 0, 0]);
        let counts = Counts {
            bytes: &encode_counts(&[5, 0, 0, 0, 300, 0]),
            zeros: 0,
        };
        assert_eq!(counts.collect::<Vec<_>>(), [5, 0, 0, 0, 300, 0]);
    }

    #[test]
    fn tones_survive_their_bytes_and_nothing_else_is_taken_for_tones() {
        let photo = Photo::from(Image::from_fn(640, 481, |x, y| {
            [(x * y % 256) as u8, (x % 250) as u8, y as u8 / 2]
        }));
        let found = tones(&DecodedPhoto::new(&photo));
        let bytes = found.encode();
        assert_eq!(ToneHistograms::decode(&bytes), Some(found.clone()));
        assert_eq!(found.pixels(), 640 * 481);
        assert_eq!(found.counts().count(), BINS);
        assert_eq!(found.counts().map(u64::from).sum::<u64>(), 3 * 640 * 481);
        for cut in [0, 3, bytes.len() / 2, bytes.len() - 1] {
            assert_eq!(ToneHistograms::decode(&bytes[..cut]), None, "cut at {cut}");
        }
        let longer = [bytes.clone(), vec![0, 0]].concat();
        assert_eq!(ToneHistograms::decode(&longer), None);
    }
}
