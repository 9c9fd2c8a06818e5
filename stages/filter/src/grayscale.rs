//! The filter `grayscale`.

use marf_scene::{Image, Sensor, Srgb};
use marf_stage::{ParamError, Verdict};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::facts::Facts;
use crate::filter::{AnyPass, Filter, MeasuredPhoto, Pass, check_range};
#[cfg(test)]
use crate::section::Guard;

/// Rejects gray photos of cameras that see colour, and colour mosaics that are not developed.
pub struct Grayscale;

/// Channels that differ by more than this make a pixel one with colour, in 8-bit steps.
const MIN_SPREAD: u8 = 8;
/// Share of pixels with colour from which on a photo has colour.
const MIN_SHARE: f64 = 0.005;
/// A camera of which nothing else is known is monochrome if at most this share of its photos has colour: a lens flare or a
/// damaged JPEG may give colour to one of many gray photos.
const MAX_COLORED: f64 = 0.05;
/// Difference of the means of the four positions of 2 x 2 pixels, in percent, from which on a gray photo is a colour mosaic.
/// Photos of monochrome cameras have at most 0.4, gray copies of carelessly interpolated colour photos up to 6, and mosaics of Mars 50
/// and more.
const MOSAIC_PERCENT: u8 = 15;
/// Name of cameras of which no name is known.
const UNNAMED: &str = "an unnamed camera";

/// Brightness, in 8-bit steps, below which a photo is dark: its colours differ by fewer steps than those of others.
const DARK: usize = 64;
/// Least brightness by which colours are enlarged, so that a single step is never colour: it may be rounding.
const DARKEST: usize = 8;

/// Which photos [`Grayscale`] keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// Photos with colour, and gray photos of monochrome cameras.
    Auto,
    /// Photos with colour: the rule of the paper.
    Color,
    /// All photos.
    All,
}

/// Parameters of [`Grayscale`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GrayscaleParams {
    /// `auto` keeps photos with colour, and gray photos of cameras that are monochrome by product name or label, or of which
    /// at most one photo in 20 has colour. `color` keeps photos with colour only (the paper), `all` keeps every photo.
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
            keep: Keep::Auto,
            min_spread: MIN_SPREAD,
            min_share: MIN_SHARE,
            by_hand: ByHand::default(),
        }
    }
}

/// Histogram of the spread of the pixels of a photo: the difference of their largest and smallest channel, enlarged where the
/// photo is dark.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChannelSpread {
    /// Bands stored in the file.
    bands: u8,
    /// Largest difference of the mean brightness of the four positions of 2 x 2 pixels, percent of their mean.
    mosaic_percent: u8,
    /// Pixels of a sample by their spread, without trailing zeros.
    pixels: Vec<u32>,
}

impl Filter for Grayscale {
    const NAME: &'static str = "grayscale";
    const ABOUT: &'static str = "rejects gray photos of colour cameras";
    const RELAX: &'static str = "`keep = \"all\"`";
    const MEASURE_VERSION: u32 = 6;
    const DECISION_VERSION: u32 = 2;
    type Params = GrayscaleParams;
    type Measure = ChannelSpread;
    type Context = ColoredPhotos;
    const MEASURE: Option<fn(&DecodedPhoto<'_>) -> ChannelSpread> = Some(|decoded| ChannelSpread {
        bands: decoded.photo.bands,
        mosaic_percent: mosaic_percent(&decoded.photo.image),
        pixels: spread(decoded.sample()),
    });

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "6 97ff2f5ba869",
        decisions: "8 d15bad30e447",
    };

    fn by_hand(params: &GrayscaleParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &GrayscaleParams) -> Result<(), ParamError> {
        check_range("min_share", params.min_share, 0.0, 1.0)
    }

    /// Only `auto` looks at the other photos of a camera.
    fn passes(params: &GrayscaleParams) -> &'static [&'static dyn AnyPass<Self>] {
        if params.keep == Keep::Auto {
            return &[&ColorsPass];
        }
        &[]
    }

    fn decide(
        params: &GrayscaleParams,
        camera: Option<&ColoredPhotos>,
        photo: &MeasuredPhoto<'_, ChannelSpread>,
    ) -> Decision {
        let (share, least) = (photo.measure.share_above(params.min_spread), params.min_share);
        if params.keep == Keep::All {
            return Decision {
                score: Some(share),
                ..Decision::pass("")
            };
        }
        if photo.measure.bands > 1 && share >= least {
            return Decision::keep(share, least);
        }
        let gray = match photo.measure.bands {
            1 => "one band".to_owned(),
            _ => format!(
                "{:.2} % of pixels with channels more than {} apart, at least {:.2} %",
                100.0 * share,
                params.min_spread,
                100.0 * least
            ),
        };
        if params.keep == Keep::Color {
            return Decision::reject(share, least, gray);
        }
        match colored(&photo.facts, &photo.measure, camera) {
            Some(why) => Decision::reject(share, least, format!("{gray}: {why}")),
            None => Decision {
                score: Some(share),
                ..Decision::pass(Verdict::kept_as_reason(
                    "monochrome",
                    photo.facts.instrument.unwrap_or(UNNAMED),
                ))
            },
        }
    }
}

/// Returns why a gray photo is not one of a monochrome camera. `None` if it is.
fn colored(facts: &Facts<'_>, measure: &ChannelSpread, camera: Option<&ColoredPhotos>) -> Option<String> {
    if measure.mosaic_percent >= MOSAIC_PERCENT {
        return Some("a colour mosaic that is not developed".to_owned());
    }
    match (facts.sensor, camera) {
        (Some(Sensor::Monochrome), _) => None,
        (Some(Sensor::Color), _) => Some("its camera sees colour by name or label".to_owned()),
        (None, Some(camera)) if camera.see_color() => Some(format!(
            "{} of {} photos of its camera have colour",
            camera.colored, camera.photos
        )),
        (None, _) => None,
    }
}

/// How many photos of a camera have colour.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ColoredPhotos {
    photos: u64,
    colored: u64,
}

impl ColoredPhotos {
    fn see_color(&self) -> bool {
        self.colored as f64 > MAX_COLORED * self.photos as f64
    }
}

/// Counts the photos of a camera and those that have colour by the default limits: no parameter changes a summary.
struct ColorsPass;

impl Pass<Grayscale> for ColorsPass {
    const NAME: &'static str = "colors";
    type Total = ColoredPhotos;

    fn summarise(_: Option<&ColoredPhotos>, photos: &[&MeasuredPhoto<'_, ChannelSpread>]) -> ColoredPhotos {
        let has_color = |photo: &&&MeasuredPhoto<'_, ChannelSpread>| {
            photo.measure.bands > 1 && photo.measure.share_above(MIN_SPREAD) >= MIN_SHARE
        };
        ColoredPhotos {
            photos: photos.len() as u64,
            colored: photos.iter().filter(has_color).count() as u64,
        }
    }

    fn add(total: &mut ColoredPhotos, summary: ColoredPhotos) -> Option<()> {
        total.photos = total.photos.checked_add(summary.photos)?;
        total.colored = total.colored.checked_add(summary.colored)?;
        Some(())
    }

    fn conclude(
        _: &GrayscaleParams,
        _: Option<ColoredPhotos>,
        total: ColoredPhotos,
    ) -> Option<ColoredPhotos> {
        Some(total)
    }
}

/// Returns the largest difference of the mean brightness of the four positions of 2 x 2 pixels, percent of their mean. 0 for
/// a black photo, and for one with colour: it is no mosaic.
fn mosaic_percent(image: &Image<Srgb>) -> u8 {
    let (mut sums, mut counts) = ([0_u64; 4], [0_u64; 4]);
    let rows = image.pixels.chunks_exact(image.width.max(1) as usize);
    for (y, row) in rows.enumerate() {
        for (x, [red, green, blue]) in row.iter().enumerate() {
            if red != green || green != blue {
                return 0;
            }
            let position = 2 * (y % 2) + x % 2;
            sums[position] += u64::from(*green);
            counts[position] += 1;
        }
    }
    let all = sums.iter().sum::<u64>();
    if all == 0 || counts.contains(&0) {
        return 0;
    }
    let means = [0, 1, 2, 3].map(|position| sums[position] as f64 / counts[position] as f64);
    let most = means.into_iter().fold(means[0], f64::max);
    let least = means.into_iter().fold(means[0], f64::min);
    (400.0 * (most - least) / means.iter().sum::<f64>()) as u8
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
