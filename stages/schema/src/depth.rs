//! `depth`: how far every pixel of the photos is, from pairs of photos, without a field.

use std::collections::BTreeMap;

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    check::{check_length, check_within},
    surface::MapReport,
};

/// Longest and shortest side of pictures that are matched.
const SIDES_PX: std::ops::RangeInclusive<u32> = 64..=8192;
/// Most pairs of a photo.
const NEIGHBOURS: std::ops::RangeInclusive<u32> = 1..=8;

/// Parameters of `depth`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DepthParams {
    /// Longest side of the pictures that are matched, pixels. Photos are shrunk to it by whole factors. 8192 takes the
    /// photos as they are, and about 16 times as long.
    pub side_px: u32,
    /// Pairs that a photo takes part in, at most. The first is of about 4 degrees and finds nearly every pixel, the others are of 8 and more
    /// exact.
    pub neighbours: u32,
    /// Width of a pixel of height map and orthophoto, metres. Default: the distance between the points.
    pub map_cell: Option<f64>,
}

impl Default for DepthParams {
    fn default() -> Self {
        Self {
            side_px: 480,
            neighbours: 3,
            map_cell: None,
        }
    }
}

impl DepthParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        check_within("side_px", self.side_px, SIDES_PX)?;
        check_within("neighbours", self.neighbours, NEIGHBOURS)?;
        check_length("map_cell", self.map_cell)
    }
}

/// Output `metrics` of `depth`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Unit of all lengths here and in the files.
    pub unit: String,
    /// The photos, in the order of the scene.
    pub photos: Vec<PhotoMetrics>,
    /// The pairs that were matched.
    pub pairs: Vec<PairMetrics>,
    /// Pairs of overlapping photos that were not matched: how many, by reason.
    pub refused: BTreeMap<String, u64>,
    /// Share of all pixels that have a depth.
    pub share: f64,
    /// Share of all pixels whose depth two pairs agree on.
    pub confirmed_share: f64,
    /// Share of all pixels that show sky, which has no depth. 0 if metres and up are not known.
    #[serde(default)]
    pub sky_share: f64,
    /// Median over the photos of their median standard deviation, as a share of the depth.
    pub median_sigma_share: Option<f64>,
    /// Points of the cloud.
    pub points: u64,
    /// Distance between the points.
    pub cell: f64,
    /// The height map. `None` if it is refused.
    pub map: Option<MapReport>,
    /// Outputs that the scene cannot give, with the reason.
    pub missing: BTreeMap<String, String>,
}

/// Depths of a photo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotoMetrics {
    /// Id of the photo.
    pub id: String,
    /// Base name of its files.
    pub name: String,
    /// Columns and rows of its files.
    pub size_px: [u32; 2],
    /// Length that one step of a value of its depth picture stands for. 0 without a depth.
    pub depth_step: f64,
    /// Pairs with a result.
    pub pairs: u32,
    /// Share of its pixels that have a depth.
    pub share: f64,
    /// Share of its pixels whose depth two pairs agree on.
    pub confirmed_share: f64,
    /// Share of its pixels whose pairs differ, which have no depth.
    pub differing_share: f64,
    /// Share of its pixels that show sky. 0 if metres and up are not known.
    #[serde(default)]
    pub sky_share: f64,
    /// Median standard deviation, as a share of the depth.
    pub median_sigma_share: Option<f64>,
    /// Why it has no depth. Empty if it has.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// A pair that was matched.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairMetrics {
    /// Base names of the left and the right photo.
    pub photos: [String; 2],
    /// Median angle between the rays of both photos to a point, degrees.
    pub angle_deg: f64,
    /// Share of the points of the photo with fewer points that both show.
    pub overlap: f64,
    /// Distance between the cameras.
    pub baseline: f64,
    /// Disparities that were tried, pixels.
    pub disparities: u32,
    /// Share of the pixels of the left picture that have a disparity.
    pub share: f64,
    /// How far the rows of the right picture were moved. `None` if the cameras put them within a quarter of a pixel, or if too few matches say
    /// where they belong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<RowOffset>,
    /// Why it has no disparities. Empty if it has.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
}

/// Where the rows of the right picture of a rectified pair are: what belongs to (x, y) is, by the cameras, in the row
/// y + offset + slope_x (x - width / 2) + slope_y (y - height / 2).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RowOffset {
    /// Pixels.
    pub offset_px: f64,
    /// Pixels of offset a pixel to the right.
    pub slope_x: f64,
    /// Pixels of offset a pixel down.
    pub slope_y: f64,
    /// Matches by which it is fitted.
    pub matches: u32,
    /// Root mean square of what is left, pixels.
    pub rms_px: f64,
}

/// How far depths are from ranges that another program measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// Pixels of the products that have a range.
    pub product_pixels: u64,
    /// Those of them where a photo has a depth.
    pub pixels: u64,
    /// Their share.
    pub share: f64,
    /// Absent without such a pixel.
    #[serde(flatten)]
    pub difference: Option<RangeDifference>,
}

/// Depth minus range, over the pixels that have both.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RangeDifference {
    /// Median, as a share of the range. Above 0, depths are farther.
    pub median_share: f64,
    /// Median of the absolute difference, metres.
    pub median_abs_m: f64,
    /// Median of the absolute difference, as a share of the range.
    pub median_abs_share: f64,
    /// 90th percentile of the absolute difference, as a share of the range.
    pub p90_abs_share: f64,
    /// Share of the pixels that differ by at most 1 % of the range.
    pub within_1_percent: f64,
    /// Share of the pixels that differ by at most 3 standard deviations of their depth.
    pub within_3_sigma: f64,
}

/// How far depths are from ranges of one octave.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OctaveAgreement {
    /// Least range, metres.
    pub from_m: f64,
    /// Where the next octave begins, metres.
    pub to_m: f64,
    /// Its pixels.
    #[serde(flatten)]
    pub agreement: Agreement,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn numbers_out_of_range_are_refused_by_key() {
        for (table, key) in [
            (json!({"side_px": 63}), "side_px"),
            (json!({"neighbours": 0}), "neighbours"),
            (json!({"neighbours": 9}), "neighbours"),
            (json!({"map_cell": 0.0}), "map_cell"),
        ] {
            let params: DepthParams = serde_json::from_value(table).unwrap();
            assert_eq!(params.check().unwrap_err().path, key);
        }
        assert_eq!(DepthParams::default().check(), Ok(()));
    }
}
