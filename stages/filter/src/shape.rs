//! The filter `shape`.

use std::collections::BTreeMap;

use marf_stage::{ParamError, Scope};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;
use crate::decision::Decision;
use crate::decoded::DecodedPhoto;
use crate::filter::{Facts, Filter, MeasuredPhoto, check_range};
#[cfg(test)]
use crate::guard::Guard;

/// Rejects thumbnails, and photos smaller than asked for or much smaller than others of the same instrument.
pub struct Shape;

/// Parameters of [`Shape`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ShapeParams {
    /// Fewest pixels a row. The paper asks for 1,000.
    pub min_width: u32,
    /// Fewest rows. The paper asks for 1,000.
    pub min_height: u32,
    /// Smallest short side as a share of the median short side among photos of the same instrument; 0 turns it
    /// off. Half-size copies have 0.5; the 8 to 16 pixels by which tiles of one camera differ do not matter.
    pub min_share: f64,
    /// A size that at least this share of the photos of an instrument has, and two photos at the least, is one of its
    /// formats (tiles, strips), to which `min_share` does not apply.
    pub common_share: f64,
    /// Fewest photos of one instrument that are compared with each other.
    pub min_set: u32,
    /// Photos kept or rejected by hand; filled from `[keep]` and `[reject]` of the pipeline.
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
    const MEASURE_VERSION: u32 = 0;
    const DECISION_VERSION: u32 = 2;
    type Params = ShapeParams;
    type Measure<'a> = ();
    /// The size is a fact of the photo.
    const MEASURE: Option<fn(&DecodedPhoto<'_>)> = None;

    #[cfg(test)]
    const GUARD: Guard = Guard {
        measures: "",
        decisions: "2 fd64df115ca8",
    };

    fn by_hand(params: &ShapeParams) -> &ByHand {
        &params.by_hand
    }

    fn check(params: &ShapeParams) -> Result<(), ParamError> {
        check_range("min_share", params.min_share, 0.0, 1.0)?;
        check_range("common_share", params.common_share, 0.0, 1.0)
    }

    /// Without `min_share` no photo is compared with others.
    fn scope(params: &ShapeParams) -> Scope {
        if params.min_share == 0.0 {
            Scope::Item
        } else {
            Scope::Set
        }
    }

    fn decide(params: &ShapeParams, photos: &[MeasuredPhoto<'_, ()>]) -> Vec<Decision> {
        let counts = count_sizes(photos);
        let decide_one =
            |photo: &MeasuredPhoto<'_, ()>| decide(params, &photo.facts, counts.get(&photo.facts.instrument));
        photos.iter().map(decide_one).collect()
    }
}

/// The number of photos of one instrument by size (short side, long side), pixels.
#[derive(Default)]
struct SizeCounts {
    sizes: BTreeMap<(u32, u32), usize>,
    photos: usize,
    /// Lower median of the short sides, pixels.
    median_short: u32,
}

impl SizeCounts {
    /// Returns the lower median of the short sides; 0 of no photos.
    fn find_median_short(&self) -> u32 {
        let mut below = 0;
        for ((short, _), count) in &self.sizes {
            below += count;
            if 2 * below >= self.photos {
                return *short;
            }
        }
        0
    }

    /// Returns whether at least this share of the photos, and at least two, have a size.
    fn is_common(&self, sides: (u32, u32), share: f64) -> bool {
        let count = self.sizes.get(&sides).copied().unwrap_or(0);
        count >= 2 && count as f64 >= share * self.photos as f64
    }
}

/// Counts the sizes of the photos of each instrument, without thumbnails: an archive may hold one for every photo.
fn count_sizes<'a>(photos: &[MeasuredPhoto<'a, ()>]) -> BTreeMap<Option<&'a str>, SizeCounts> {
    let mut counts = BTreeMap::<_, SizeCounts>::new();
    for photo in photos.iter().filter(|photo| !photo.facts.thumbnail) {
        let sizes = counts.entry(photo.facts.instrument).or_default();
        *sizes.sizes.entry(sides(&photo.facts)).or_default() += 1;
        sizes.photos += 1;
    }
    for sizes in counts.values_mut() {
        sizes.median_short = sizes.find_median_short();
    }
    counts
}

/// Returns the short and the long side.
fn sides(facts: &Facts<'_>) -> (u32, u32) {
    (facts.width.min(facts.height), facts.width.max(facts.height))
}

/// Decides on one photo.
fn decide(params: &ShapeParams, facts: &Facts<'_>, counts: Option<&SizeCounts>) -> Decision {
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
    let set = counts.filter(|counts| counts.photos >= params.min_set as usize);
    let (short, usual) = (sides(facts).0, set.map_or(0, |counts| counts.median_short));
    let least = params.min_share * f64::from(usual);
    let common = counts.is_some_and(|counts| counts.is_common(sides(facts), params.common_share));
    if f64::from(short) < least && !common {
        let reason =
            format!("{size}, an odd one out: short side {short}, usual {usual}, at least {least:.0}");
        return Decision::reject(f64::from(short), least, reason);
    }
    Decision::keep(f64::from(short), least)
}
