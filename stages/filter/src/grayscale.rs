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
    /// makes differences of a few steps in a gray photo.
    pub min_spread: u8,
    /// Smallest share of pixels with colour, in [0, 1].
    pub min_share: f64,
    /// Photos kept or rejected by hand; filled from `[keep]` and `[reject]` of the pipeline.
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

/// Histogram of the spread of the pixels of a photo: the difference of their largest and smallest channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChannelSpread {
    /// Bands stored in the file.
    bands: u8,
    /// Pixels of a sample by their spread; trailing zeros are left out.
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
    const MEASURE_VERSION: u32 = 3;
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
        measures: "3 506c7beb9c1e",
        decisions: "3 4e119ff2c0a0",
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
    let mut pairs = vec![[0_u32; 2]; 256];
    for (at, [red, green, blue]) in pixels.enumerate() {
        let spread = red.max(green).max(blue) - red.min(green).min(blue);
        pairs[usize::from(spread)][at % 2] += 1;
    }
    let mut counts: Vec<u32> = pairs.into_iter().map(|pair| pair[0] + pair[1]).collect();
    let used = counts
        .iter()
        .rposition(|count| *count > 0)
        .map_or(0, |last| last + 1);
    counts.truncate(used);
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
