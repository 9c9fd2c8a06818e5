//! The filter `shape`.

use std::collections::{BTreeMap, BTreeSet};

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::facts::Facts;
use crate::filter::{AnyPass, Filter, MeasuredPhoto, Pass, check_range};
#[cfg(test)]
use crate::section::Guard;

/// Rejects thumbnails, and photos smaller than asked for or much smaller than others of the same instrument.
pub struct Shape;

/// Parameters of [`Shape`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ShapeParams {
    /// Smallest width, pixels. The paper uses 1,000.
    pub min_width: u32,
    /// Smallest height, pixels. The paper uses 1,000.
    pub min_height: u32,
    /// Smallest short side as a share of the median short side among photos of the same instrument. 0 turns it off.
    /// Half-size copies have 0.5. The 8 to 16 pixels by which tiles of one camera differ do not matter.
    pub min_share: f64,
    /// A size of at least this share of an instrument's photos, and of at least two, is one of its formats (tiles,
    /// strips). `min_share` does not apply to formats.
    pub common_share: f64,
    /// Fewest photos of one instrument that are compared with each other.
    pub min_set: u32,
    /// Photos kept or rejected by hand, filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for ShapeParams {
    fn default() -> Self {
        Self {
            min_width: 320,
            min_height: 240,
            min_share: 0.6,
            common_share: 0.1,
            min_set: 5,
            by_hand: ByHand::default(),
        }
    }
}

impl Filter for Shape {
    const NAME: &'static str = "shape";
    const ABOUT: &'static str = "rejects thumbnails and photos that are too small";
    const RELAX: &'static str = "a lower `min_width` or `min_height`";
    const MEASURE_VERSION: u32 = 0;
    const DECISION_VERSION: u32 = 3;
    type Params = ShapeParams;
    type Measure = ();
    type Context = UsualSizes;
    /// The size is a fact of the photo.
    const MEASURE: Option<fn(&DecodedPhoto<'_>)> = None;

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "",
        decisions: "3 fd64df115ca8",
    };

    fn by_hand(params: &ShapeParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &ShapeParams) -> Result<(), ParamError> {
        check_range("min_share", params.min_share, 0.0, 1.0)?;
        check_range("common_share", params.common_share, 0.0, 1.0)
    }

    /// Without `min_share` no photo is compared with others.
    fn passes(params: &ShapeParams) -> &'static [&'static dyn AnyPass<Self>] {
        if params.min_share == 0.0 {
            return &[];
        }
        &[&SizesPass]
    }

    fn decide(params: &ShapeParams, usual: Option<&UsualSizes>, photo: &MeasuredPhoto<'_, ()>) -> Decision {
        decide(params, &photo.facts, usual)
    }
}

/// Sizes (short side, long side), pixels.
type Sides = (u32, u32);

/// What the photos of one instrument are compared with.
#[derive(Serialize, Deserialize)]
pub struct UsualSizes {
    /// Lower median of the short sides, pixels.
    median_short: u32,
    /// The formats of the instrument with a short side that is too short for any other photo.
    short_formats: BTreeSet<Sides>,
}

/// The number of photos by size, without thumbnails: an archive may hold one for every photo.
struct SizesPass;

impl Pass<Shape> for SizesPass {
    const NAME: &'static str = "sizes";
    type Total = BTreeMap<Sides, u64>;

    fn summarise(_: Option<&UsualSizes>, photos: &[&MeasuredPhoto<'_, ()>]) -> Self::Total {
        let mut sizes = Self::Total::new();
        for photo in photos.iter().filter(|photo| !photo.facts.thumbnail) {
            *sizes.entry(sides(&photo.facts)).or_default() += 1;
        }
        sizes
    }

    fn add(total: &mut Self::Total, summary: Self::Total) -> Option<()> {
        for (sides, count) in summary {
            let total = total.entry(sides).or_default();
            *total = total.checked_add(count)?;
        }
        Some(())
    }

    fn conclude(params: &ShapeParams, _: Option<UsualSizes>, sizes: Self::Total) -> Option<UsualSizes> {
        let photos: u64 = sizes.values().sum();
        if photos == 0 || photos < u64::from(params.min_set) {
            return None;
        }
        let median_short = median_short(&sizes, photos);
        let least = least_short(params, median_short);
        let is_common = |count: u64| count >= 2 && count as f64 >= params.common_share * photos as f64;
        let formats = sizes
            .into_iter()
            .filter(|((short, _), count)| f64::from(*short) < least && is_common(*count));
        Some(UsualSizes {
            median_short,
            short_formats: formats.map(|(sides, _)| sides).collect(),
        })
    }
}

/// Returns the lower median of the short sides. 0 without photos.
fn median_short(sizes: &BTreeMap<Sides, u64>, photos: u64) -> u32 {
    let mut below = 0;
    for ((short, _), count) in sizes {
        below += count;
        if 2 * below >= photos {
            return *short;
        }
    }
    0
}

/// Returns the least short side of a photo that has none of the formats.
fn least_short(params: &ShapeParams, median_short: u32) -> f64 {
    params.min_share * f64::from(median_short)
}

/// Returns the short and the long side.
fn sides(facts: &Facts<'_>) -> Sides {
    (facts.width.min(facts.height), facts.width.max(facts.height))
}

/// Decides on one photo.
fn decide(params: &ShapeParams, facts: &Facts<'_>, usual: Option<&UsualSizes>) -> Decision {
    let (width, height) = (f64::from(facts.width), f64::from(facts.height));
    let size = format!("{} x {} pixels", facts.width, facts.height);
    if facts.thumbnail {
        return Decision::reject(
            width,
            f64::from(params.min_width),
            format!("{size}, a thumbnail by its name"),
        );
    }
    if facts.width < params.min_width {
        let least = params.min_width;
        return Decision::reject(width, f64::from(least), format!("{size}, width at least {least}"));
    }
    if facts.height < params.min_height {
        let least = params.min_height;
        return Decision::reject(
            height,
            f64::from(least),
            format!("{size}, height at least {least}"),
        );
    }
    let sides = sides(facts);
    let (short, usual_short) = (sides.0, usual.map_or(0, |usual| usual.median_short));
    let least = least_short(params, usual_short);
    let is_format = usual.is_some_and(|usual| usual.short_formats.contains(&sides));
    if f64::from(short) < least && !is_format {
        let reason =
            format!("{size}, an odd one out: short side {short}, usual {usual_short}, at least {least:.0}");
        return Decision::reject(f64::from(short), least, reason);
    }
    Decision::keep(f64::from(short), least)
}
