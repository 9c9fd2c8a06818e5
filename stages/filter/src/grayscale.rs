//! The filter `grayscale`.

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::bytes::{Stored, put_number, take_number};
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::filter::{Filter, MeasuredPhoto, check_range};
#[cfg(test)]
use crate::section::Guard;

/// Rejects photos without colour: one band, or three equal ones within the noise of JPEG.
pub struct Grayscale;

/// Brightness, in 8-bit steps, below which a photo is dark: its colours differ by fewer steps than those of others.
const DARK: usize = 64;
/// Least brightness by which colours are enlarged, so that a single step is never colour: it may be rounding.
const DARKEST: usize = 8;

/// Which photos [`Grayscale`] keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// Photos with colour.
    Color,
    /// All photos: for missions whose cameras are monochrome.
    All,
}

/// Parameters of [`Grayscale`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GrayscaleParams {
    /// `color` keeps photos with colour, `all` keeps every photo (monochrome missions).
    pub keep: Keep,
    /// A pixel has colour if its largest and smallest channel differ by more than this, in 8-bit steps. JPEG
    /// makes differences of a few steps in a gray photo. In a photo whose brightest percent is below 64 the differences are
    /// enlarged, as if it were 64.
    pub min_spread: u8,
    /// Smallest share of pixels with colour, in [0, 1].
    pub min_share: f64,
    /// Photos kept or rejected by hand, filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for GrayscaleParams {
    fn default() -> Self {
        Self {
            keep: Keep::Color,
            min_spread: 8,
            min_share: 0.005,
            by_hand: ByHand::default(),
        }
    }
}

/// Histogram of the spread of the pixels of a photo: the difference of their largest and smallest channel, enlarged where the
/// photo is dark.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChannelSpread {
    /// Bands stored in the file.
    bands: u8,
    /// Pixels of a sample by their spread, without trailing zeros.
    pixels: Vec<u32>,
}

/// One byte for the bands, then the counts.
impl Stored<'_> for ChannelSpread {
    fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![self.bands];
        self.pixels
            .iter()
            .for_each(|count| put_number(&mut bytes, u64::from(*count)));
        bytes
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        let (bands, mut rest) = bytes.split_first()?;
        let mut pixels = Vec::new();
        while !rest.is_empty() {
            pixels.push(u32::try_from(take_number(&mut rest)?).ok()?);
        }
        (pixels.len() <= 256 && matches!(bands, 1 | 3)).then_some(Self {
            bands: *bands,
            pixels,
        })
    }
}

impl Filter for Grayscale {
    const NAME: &'static str = "grayscale";
    const ABOUT: &'static str = "rejects photos without colour";
    const RELAX: &'static str = "`keep = \"all\"`, as for monochrome cameras";
    const MEASURE_VERSION: u32 = 4;
    const DECISION_VERSION: u32 = 0;
    type Params = GrayscaleParams;
    type Measure<'a> = ChannelSpread;
    type Context = ();
    const MEASURE: Option<fn(&DecodedPhoto<'_>) -> ChannelSpread> = Some(|decoded| ChannelSpread {
        bands: decoded.photo.bands,
        pixels: spread(decoded.sample()),
    });

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "4 506c7beb9c1e",
        decisions: "4 4e119ff2c0a0",
    };

    fn by_hand(params: &GrayscaleParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &GrayscaleParams) -> Result<(), ParamError> {
        check_range("min_share", params.min_share, 0.0, 1.0)
    }

    fn decide(
        params: &GrayscaleParams,
        _: Option<&()>,
        photo: &MeasuredPhoto<'_, ChannelSpread>,
    ) -> Decision {
        let (share, least) = (photo.measure.share_above(params.min_spread), params.min_share);
        if params.keep == Keep::All {
            return Decision {
                score: Some(share),
                ..Decision::pass("")
            };
        }
        if photo.measure.bands == 1 {
            return Decision::reject(share, least, "one band");
        }
        if share < least {
            let reason = format!(
                "{:.2} % of pixels with channels more than {} apart, at least {:.2} %",
                100.0 * share,
                params.min_spread,
                100.0 * least
            );
            return Decision::reject(share, least, reason);
        }
        Decision::keep(share, least)
    }
}

/// Counts pixels by their spread.
fn spread(pixels: impl Iterator<Item = [u8; 3]>) -> Vec<u32> {
    // Neighbours often have the same spread, and a count must be written before it can be read again: hence two of each.
    let (mut pairs, mut bright) = ([[0_u32; 2]; 256], [[0_u32; 2]; 256]);
    for (at, [red, green, blue]) in pixels.enumerate() {
        let most = red.max(green).max(blue);
        pairs[usize::from(most - red.min(green).min(blue))][at % 2] += 1;
        bright[usize::from(most)][at % 2] += 1;
    }
    let sums = |pairs: [[u32; 2]; 256]| pairs.map(|pair| pair[0] + pair[1]);
    let mut counts = enlarged(&sums(pairs), brightest(&sums(bright))).to_vec();
    let used = counts
        .iter()
        .rposition(|count| *count > 0)
        .map_or(0, |last| last + 1);
    counts.truncate(used);
    counts
}

/// Returns the brightness that at most 1 % of the pixels exceed.
fn brightest(pixels: &[u32; 256]) -> usize {
    let all: u64 = pixels.iter().map(|count| u64::from(*count)).sum();
    let mut above = 0;
    let exceeds = |count: &u32| {
        above += u64::from(*count);
        100 * above > all
    };
    pixels.iter().rposition(exceeds).unwrap_or(0)
}

/// Returns the pixels by their spread in a photo of this brightness, enlarged as if it were [`DARK`] where it is darker.
fn enlarged(pixels: &[u32; 256], brightness: usize) -> [u32; 256] {
    if brightness >= DARK {
        return *pixels;
    }
    let mut counts = [0; 256];
    for (spread, count) in pixels.iter().enumerate() {
        counts[(spread * DARK / brightness.max(DARKEST)).min(255)] += count;
    }
    counts
}

impl ChannelSpread {
    /// Returns the share of pixels whose spread is above `limit`, in [0, 1].
    fn share_above(&self, limit: u8) -> f64 {
        let all: u64 = self.pixels.iter().map(|count| u64::from(*count)).sum();
        let above = self.pixels.iter().skip(usize::from(limit) + 1);
        above.map(|count| u64::from(*count)).sum::<u64>() as f64 / all.max(1) as f64
    }
}
