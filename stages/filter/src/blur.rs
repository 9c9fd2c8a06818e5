//! The filter `blur`.

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::filter::{AnyPass, Filter, MeasuredPhoto, Pass, check_range};
use crate::octave::Octave;
#[cfg(test)]
use crate::section::Guard;
use crate::statistics::{BinCounts, LogBins, Quantile, Steps};

/// Rejects photos that are out of focus, smeared by motion, or nothing but noise.
pub struct Blur;

/// The rule of [`Blur`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BlurRule {
    /// Ratio of detail before and after one more blur: a blurred photo loses little.
    Reblur,
    /// The paper's rule: photos whose Laplacian has a variance below `tau` are rejected.
    Laplacian,
}

/// Parameters of [`Blur`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BlurParams {
    /// `reblur` (default) or `laplacian` (the paper).
    pub rule: BlurRule,
    /// Smallest reblur ratio if there are fewer than `min_set` photos of the instrument.
    pub min_ratio: f64,
    /// With `min_set` photos and more, the smallest ratio at each size is this share of the median of the
    /// instrument's other photos at that size. It is never below `floor_ratio` nor above `ceiling_ratio`.
    pub min_share: f64,
    /// A photo with a smaller ratio is always blurred.
    pub floor_ratio: f64,
    /// A photo with a larger ratio is never blurred.
    pub ceiling_ratio: f64,
    /// Fewest photos of one instrument that are compared with each other.
    pub min_set: u32,
    /// Largest ratio at full size: above it the photo is noise or an undeveloped Bayer mosaic.
    pub max_ratio: f64,
    /// The largest ratio is at least this multiple of the median of the other photos of the instrument.
    pub max_multiple: f64,
    /// Smallest variance of the Laplacian in squared 8-bit steps, for `rule = "laplacian"`.
    pub tau: f64,
    /// Photos kept or rejected by hand, filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for BlurParams {
    fn default() -> Self {
        Self {
            rule: BlurRule::Reblur,
            min_ratio: 9.0,
            min_share: 0.55,
            floor_ratio: 3.0,
            ceiling_ratio: 11.5,
            min_set: 5,
            max_ratio: 400.0,
            max_multiple: 6.0,
            tau: 60.0,
            by_hand: ByHand::default(),
        }
    }
}

/// Sharpness of one photo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sharpness {
    /// Variance of the 4-neighbour Laplacian, squared 8-bit steps.
    laplacian: f64,
    /// Full, half and quarter size, as far as they have 3 pixels on both sides.
    octaves: [Option<Octave>; OCTAVES],
}

/// Number of sizes, each half of the one before. A motion of 15 pixels leaves only the noise of JPEG at full size
/// (ratio 8 to 14), but shows at half size (4 to 8).
const OCTAVES: usize = 3;

impl Sharpness {
    /// Returns the sizes that were measured, the largest first.
    fn octaves(&self) -> impl Iterator<Item = &Octave> {
        self.octaves.iter().flatten()
    }
}

impl Filter for Blur {
    const NAME: &'static str = "blur";
    const ABOUT: &'static str = "rejects photos that are blurred or mere noise";
    const RELAX: &'static str = "a lower `floor_ratio` or `min_ratio`";
    const MEASURE_VERSION: u32 = 4;
    const DECISION_VERSION: u32 = 1;
    type Params = BlurParams;
    type Measure = Sharpness;
    type Context = RatioLimits;
    const MEASURE: Option<fn(&DecodedPhoto<'_>) -> Sharpness> = Some(sharpness);

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "4 d6843f961313",
        decisions: "5 d26ff894355b",
    };

    fn by_hand(params: &BlurParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &BlurParams) -> Result<(), ParamError> {
        check_range("min_ratio", params.min_ratio, 0.01, 1e6)?;
        check_range("min_share", params.min_share, 0.0, 1.0)?;
        check_range("ceiling_ratio", params.ceiling_ratio, 0.0, 1e6)?;
        check_range("floor_ratio", params.floor_ratio, 0.01, params.ceiling_ratio)?;
        check_range("max_ratio", params.max_ratio, params.min_ratio, 1e12)?;
        check_range("max_multiple", params.max_multiple, 1.0, 1e6)?;
        check_range("tau", params.tau, 0.0, 1e6)
    }

    fn passes(params: &BlurParams) -> &'static [&'static dyn AnyPass<Self>] {
        match params.rule {
            BlurRule::Reblur => &[&RatiosPass],
            BlurRule::Laplacian => &[],
        }
    }

    fn decide(
        params: &BlurParams,
        limits: Option<&RatioLimits>,
        photo: &MeasuredPhoto<'_, Sharpness>,
    ) -> Decision {
        match params.rule {
            BlurRule::Reblur => decide_reblur(params, &photo.measure, limits),
            BlurRule::Laplacian => decide_laplacian(params, &photo.measure),
        }
    }
}

/// Measures the sharpness of a photo.
fn sharpness(decoded: &DecodedPhoto<'_>) -> Sharpness {
    let luma = decoded.luma();
    let large = |width: usize, height: usize| width > 2 && height > 2;
    let mut octaves = [None; OCTAVES];
    if large(luma.width, luma.height) {
        octaves[0] = Some(Octave::from_luma(luma));
        let mut plane = luma.halved();
        for octave in &mut octaves[1..] {
            plane = plane.filter(|plane| large(plane.width, plane.height));
            *octave = plane.as_ref().map(Octave::from_plane);
            plane = plane.and_then(|plane| plane.halved());
        }
    }
    Sharpness {
        laplacian: decoded.laplacian().variance,
        octaves,
    }
}

/// Bins of reblur ratios, 0.8 to 1.6 % wide. Medians are at most half a bin off, and the median of 10,000 photos
/// stays in its bin when 100 more come.
const RATIOS: LogBins = LogBins { bits: 6 };

/// The limits of reblur ratios where the photos of an instrument are compared with each other. They depend on the
/// ratio of the photo under decision, which is left out of the medians.
#[derive(Serialize, Deserialize)]
pub struct RatioLimits {
    /// Of the smaller ratio of both axes, by number of halvings.
    least: [Steps; OCTAVES],
    /// Of the larger ratio of both axes at full size.
    most: Steps,
}

/// The distribution of the reblur ratios.
struct RatiosPass;

/// The reblur ratios of the photos of an instrument.
#[derive(Default, Serialize, Deserialize)]
struct Ratios {
    photos: u64,
    /// Smaller ratio of both axes, by number of halvings.
    lowest: [BinCounts; OCTAVES],
    /// Larger ratio of both axes at full size.
    finest: BinCounts,
}

impl Pass<Blur> for RatiosPass {
    const NAME: &'static str = "ratios";
    type Total = Ratios;

    fn summarise(_: Option<&RatioLimits>, photos: &[&MeasuredPhoto<'_, Sharpness>]) -> Ratios {
        let octaves = |halvings: usize| {
            photos
                .iter()
                .filter_map(move |photo| photo.measure.octaves().nth(halvings))
        };
        Ratios {
            photos: photos.len() as u64,
            lowest: std::array::from_fn(|halvings| {
                BinCounts::new(octaves(halvings).filter_map(|octave| RATIOS.bin(octave.lowest().0)))
            }),
            finest: BinCounts::new(octaves(0).filter_map(|octave| RATIOS.bin(octave.highest()))),
        }
    }

    fn add(total: &mut Ratios, summary: Ratios) -> Option<()> {
        total.photos = total.photos.checked_add(summary.photos)?;
        for (total, summary) in total.lowest.iter_mut().zip(&summary.lowest) {
            total.add(summary)?;
        }
        total.finest.add(&summary.finest)
    }

    fn conclude(params: &BlurParams, _: Option<RatioLimits>, ratios: Ratios) -> Option<RatioLimits> {
        let median = |counts: &BinCounts| counts.quantile_without(Quantile::MEDIAN, RATIOS);
        let least = |usual: f64| (params.min_share * usual).clamp(params.floor_ratio, params.ceiling_ratio);
        let most = |usual: f64| (params.max_multiple * usual).max(params.max_ratio);
        (ratios.photos >= u64::from(params.min_set)).then(|| RatioLimits {
            least: ratios.lowest.each_ref().map(|counts| median(counts).map(least)),
            most: median(&ratios.finest).map(most),
        })
    }
}

/// Returns the smallest ratio that a photo of this `ratio` needs after this number of halvings.
fn min_ratio(params: &BlurParams, limits: Option<&RatioLimits>, halvings: usize, ratio: f64) -> f64 {
    limits.map_or(params.min_ratio, |limits| {
        limits.least[halvings].at(RATIOS.bin(ratio))
    })
}

/// Returns the largest ratio at full size that a photo of this `ratio` may have.
fn max_ratio(params: &BlurParams, limits: Option<&RatioLimits>, ratio: f64) -> f64 {
    limits.map_or(params.max_ratio, |limits| limits.most.at(RATIOS.bin(ratio)))
}

/// Decides by the rule [`BlurRule::Reblur`].
fn decide_reblur(params: &BlurParams, photo: &Sharpness, limits: Option<&RatioLimits>) -> Decision {
    let Some(fine) = photo.octaves().next() else {
        return Decision::reject(
            0.0,
            params.min_ratio,
            "fewer than 3 pixels a side: nothing can be sharp",
        );
    };
    let worst = photo.octaves().enumerate().map(|(halvings, octave)| {
        let (ratio, axis) = octave.lowest();
        (ratio, min_ratio(params, limits, halvings, ratio), halvings, axis)
    });
    let worst = worst.min_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    let (ratio, least, halvings, axis) = worst.unwrap_or((0.0, params.min_ratio, 0, 0));
    if ratio < least {
        let (part, axis) = (1 << halvings, ["rows", "columns"][axis]);
        let reason =
            format!("reblur ratio {ratio:.1} at 1/{part} of the size along {axis}, at least {least:.1}");
        return Decision::reject(ratio, least, reason);
    }
    let (finest, most) = (fine.highest(), max_ratio(params, limits, fine.highest()));
    if finest > most {
        return Decision::reject(
            finest,
            most,
            format!("reblur ratio {finest:.0}, at most {most:.0}: noise or a raw mosaic"),
        );
    }
    Decision::keep(ratio, least)
}

/// Decides by the rule [`BlurRule::Laplacian`].
fn decide_laplacian(params: &BlurParams, photo: &Sharpness) -> Decision {
    let (variance, tau) = (photo.laplacian, params.tau);
    if variance < tau {
        return Decision::reject(
            variance,
            tau,
            format!("variance of the Laplacian {variance:.1}, at least {tau}"),
        );
    }
    Decision::keep(variance, tau)
}
