//! The tones of a photo: histograms of brightness and colour differences, and counts of its lost areas.

use serde::{Deserialize, Serialize};

use crate::bytes::read_list;
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

/// Histograms of brightness and colour differences of a photo, and counts of its lost areas.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ToneHistograms {
    /// Whole 8 x 8 blocks, counted from the top left corner.
    blocks: u32,
    /// Blocks of one single brightness.
    flat_blocks: u32,
    /// Pixels of the sample that are burnt out or black.
    clipped: u32,
    /// The counts of all bins, channel by channel: 0.5 to 1.4 KB as bytes.
    #[serde(deserialize_with = "read_list::<BINS, _, _>")]
    counts: Vec<u32>,
}

impl ToneHistograms {
    /// Returns the share of blocks of one single brightness, in [0, 1].
    pub(crate) fn flat_share(&self) -> f64 {
        f64::from(self.flat_blocks) / f64::from(self.blocks.max(1))
    }

    /// Returns the share of pixels that are burnt out or black, in [0, 1].
    pub(crate) fn clipped_share(&self) -> f64 {
        f64::from(self.clipped) / self.pixels().max(1) as f64
    }

    /// Returns the number of pixels that were counted, the sum of each histogram.
    pub(crate) fn pixels(&self) -> u64 {
        let (_, bins, _) = CHANNELS[0];
        self.counts[..bins].iter().map(|count| u64::from(*count)).sum()
    }

    /// Returns the counts of all bins, channel by channel.
    pub(crate) fn counts(&self) -> &[u32] {
        &self.counts
    }
}

/// Measures the tones of a photo.
pub(crate) fn tones(decoded: &DecodedPhoto<'_>) -> ToneHistograms {
    // Neighbours are often in the same bin, and a count must be written before it can be read again: hence two of each.
    let mut pairs = [[0_u32; 2]; BINS];
    let mut clipped = 0;
    for (at, pixel) in decoded.sample().enumerate() {
        let [red, green, blue] = pixel;
        let difference = |channel: u8| (256 + usize::from(channel) - usize::from(green)) / 4;
        let most = red.max(green).max(blue);
        clipped += u32::from(!(BLACK + 1..BURNT).contains(&most));
        pairs[usize::from(luma(pixel))][at % 2] += 1;
        pairs[256 + difference(red)][at % 2] += 1;
        pairs[384 + difference(blue)][at % 2] += 1;
    }
    let bins = pairs.map(|pair| pair[0] + pair[1]);
    let luma = decoded.luma();
    ToneHistograms {
        blocks: ((luma.width / BLOCK) * (luma.height / BLOCK)) as u32,
        flat_blocks: flat_blocks(luma),
        clipped,
        counts: bins.to_vec(),
    }
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
    use crate::bytes::{from_bytes, to_bytes};

    #[test]
    fn tones_survive_their_bytes_and_nothing_else_is_taken_for_tones() {
        let photo = Photo::from(Image::from_fn(640, 481, |x, y| {
            [(x * y % 256) as u8, (x % 250) as u8, y as u8 / 2]
        }));
        let found = tones(&DecodedPhoto::new(&photo));
        let bytes = to_bytes(&found).unwrap();
        assert_eq!(from_bytes(&bytes), Some(found.clone()));
        assert_eq!(found.pixels(), 640 * 481);
        assert_eq!(found.counts().len(), BINS);
        assert_eq!(found.counts().iter().sum::<u32>(), 3 * 640 * 481);
        for cut in [0, 3, bytes.len() / 2, bytes.len() - 1] {
            assert_eq!(from_bytes::<ToneHistograms>(&bytes[..cut]), None, "cut at {cut}");
        }
        let longer = [bytes.clone(), vec![0, 0]].concat();
        assert_eq!(from_bytes::<ToneHistograms>(&longer), None);
    }
}
