//! `bootstrap`: B retrainings to uncertainty maps and the pictures of a fly-through.

use marf_field::{Device, Overrides, Quality};
use marf_stage::{Document, ParamError, Params};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{check_field, train::Fit};

/// What differs between members.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The seed: first weights and order of rays, as in the paper.
    #[default]
    Seeds,
    /// The seed and the photos, drawn anew with replacement: a bootstrap in the sense of statistics.
    Photos,
}

/// Where maps are made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Viewpoints {
    /// At the photos held out, where the truth is known.
    #[default]
    Heldout,
    /// Along the fly-through.
    Flythrough,
    /// Around the point the cameras look at.
    Orbit,
}

/// What the fly-through shows between the mean colour and the depth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Shown {
    /// Sample standard deviation of gray.
    #[default]
    Std,
    /// With the opacity term: what no photo saw stands out, and so does a learnt sky.
    Total,
}

/// Parameters of `bootstrap`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BootstrapParams {
    /// Retrainings, at least 2. Five rank pixels well; intervals want ten.
    pub b: u32,
    /// What differs between members.
    pub mode: Mode,
    /// Seed of the first member; each further one adds 1. With `of` and its seed the first member is that training again.
    pub seed: u64,
    /// Steps, size of the photos and size of the field, as for `train`; `of` decides all four keys from here to `field`.
    pub quality: Quality,
    /// Optimiser steps of a member, instead of those of `quality`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Whole factor by which photos are shrunk; absent: as for `train`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Keys of the field; they win over those of the input `params`.
    pub field: Overrides,
    /// Where maps are made.
    pub viewpoints: Viewpoints,
    /// Number of viewpoints, where they are not photos.
    pub map_frames: u32,
    /// Pictures of the fly-through, at least 1; each takes `b` renders. `video` makes a film of them.
    pub frames: u32,
    /// Width of each of the three panels of the fly-through (mean colour, uncertainty, depth), pixels, at most 1280.
    pub width: u32,
    /// What the fly-through shows between the mean colour and the depth.
    pub show: Shown,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    pub device: Device,
}

impl Default for BootstrapParams {
    fn default() -> Self {
        Self {
            b: 5,
            mode: Mode::Seeds,
            seed: 0,
            quality: Quality::default(),
            steps: None,
            scale: None,
            field: Overrides::default(),
            viewpoints: Viewpoints::Heldout,
            map_frames: 6,
            frames: 96,
            width: 480,
            show: Shown::Std,
            device: Device::default(),
        }
    }
}

/// Most members; beyond it a number is a slip.
const MAX_MEMBERS: u32 = 1000;
/// Widest panel of three in a picture that can be encoded, and longest fly-through.
const MAX_WIDTH_PX: u32 = marf_video::MAX_LONG_PX / 3;
const MAX_FRAMES: u32 = 10_000;

impl Params for BootstrapParams {
    const STAGE: &'static str = "bootstrap";
}

impl BootstrapParams {
    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        if self.b < 2 {
            let message = format!(
                "{} member has no spread: at least 2, 5 for maps, 10 for intervals",
                self.b
            );
            return Err(ParamError::new("b", message));
        }
        let at_most = |key: &str, value: u32, most: u32| {
            let message = || format!("{value} is more than {most}");
            if value > most {
                Err(ParamError::new(key, message()))
            } else {
                Ok(())
            }
        };
        let above_zero = |key: &str, value: u64| match value {
            0 => Err(ParamError::new(key, "0 gives nothing; at least 1")),
            _ => Ok(()),
        };
        at_most("b", self.b, MAX_MEMBERS)?;
        at_most("frames", self.frames, MAX_FRAMES)?;
        at_most("map_frames", self.map_frames, MAX_FRAMES)?;
        at_most("width", self.width, MAX_WIDTH_PX)?;
        above_zero("frames", u64::from(self.frames))?;
        above_zero("width", u64::from(self.width))?;
        above_zero("map_frames", u64::from(self.map_frames))?;
        above_zero("steps", self.steps.unwrap_or(1))?;
        above_zero("scale", u64::from(self.scale.unwrap_or(1)))?;
        check_field(self.quality, Fit::Scene, &self.field)
    }
}

/// Output `metrics` of `bootstrap`. Spreads are of sRGB in [0, 1], means over all pixels of all viewpoints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Members.
    pub b: u32,
    /// What differs between them.
    pub mode: Mode,
    /// Mean sample standard deviation of gray, divisor B - 1.
    pub std: f64,
    /// The paper's figure: mean standard deviation of gray, divisor B.
    pub std_paper: f64,
    /// Mean sample standard deviation of each channel.
    pub std_rgb: [f64; 3],
    /// Mean opacity term.
    pub opacity_term: f64,
    /// Mean total standard deviation.
    pub total_sd: f64,
    /// Mean sample standard deviation of the depth where it is seen, world units.
    pub depth_std: Option<f64>,
    /// Share of pixels where the mean opacity is at most 0.5.
    pub unseen_share: f64,
    /// The members, in order.
    pub members: Vec<Member>,
    /// What the photos held out say; none where the viewpoints are not photos.
    pub heldout: Option<HeldOut>,
    /// Every viewpoint.
    pub views: Vec<ViewReport>,
}

impl Document for Metrics {
    const STAGE: &'static str = BootstrapParams::STAGE;
    const OUTPUT: &'static str = "metrics";
}

/// A member, from its own metrics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// Its seed.
    pub seed: u64,
    /// Factor by which its photos were shrunk.
    pub scale: u32,
    /// Mean PSNR on the photos held out, dB.
    pub psnr: f64,
    /// Mean SSIM on them.
    pub ssim: Option<f64>,
}

/// One viewpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewReport {
    /// Name of its maps.
    pub name: String,
    /// Mean sample standard deviation of gray.
    pub std: f64,
    /// The same with divisor B.
    pub std_paper: f64,
    /// Mean opacity term.
    pub opacity_term: f64,
    /// Mean total standard deviation.
    pub total_sd: f64,
    /// Mean standard deviation of the depth where it is seen, world units.
    pub depth_std: Option<f64>,
    /// Share of pixels unseen.
    pub unseen_share: f64,
    /// How well the spread ranks the errors; only where there is a photo.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub photo: Option<PhotoReport>,
}

/// A viewpoint compared with its photo. Errors are |mean gray - gray of the photo|.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhotoReport {
    /// PSNR of the mean render, dB.
    pub psnr: f64,
    /// Area under the sparsification error by the standard deviation, mean absolute error.
    pub ause_mae: f64,
    /// Of a random order.
    pub ause_mae_random: f64,
    /// Root mean squared error.
    pub ause_rmse: f64,
    /// Of a random order.
    pub ause_rmse_random: f64,
    /// By the total standard deviation, mean absolute error.
    pub ause_mae_total: f64,
    /// Rank correlation of standard deviation and error.
    pub spearman: f64,
}

/// What the photos held out say about the spread.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Means of [`PhotoReport`] over photos, `spearman` as the median.
    #[serde(flatten)]
    pub mean: PhotoReport,
    /// Mean of the members' own PSNR, dB: what averaging gains is the difference.
    pub psnr_members_mean: f64,
    /// Share of pixels whose error lies within the spread.
    pub coverage: Coverage,
    /// What these would be, were the errors normal with that spread.
    pub coverage_nominal: Coverage,
    /// Mean negative log-likelihood of the errors, nats, to six decimals.
    pub nll: f64,
    /// Fitted on half of the photos and tested on the other; none with fewer than four.
    pub calibration: Option<Calibration>,
}

/// Shares of pixels whose error is at most 1, 2 and 3 standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Within one.
    pub sd1: f64,
    /// Within two.
    pub sd2: f64,
    /// Within three.
    pub sd3: f64,
}

/// How far intervals hold on photos they were not fitted on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Factor on the spread, fitted on half of the photos: t² = mean e² / s².
    pub t: f64,
    /// Mean |share inside - nominal| over 19 nominal shares, on the other half, after scaling by t.
    pub ece: f64,
    /// Share of the other half inside the distribution-free 90 % interval.
    pub coverage90: Option<f64>,
    /// Photos fitted on.
    pub fit_photos: u64,
    /// Photos tested on.
    pub test_photos: u64,
    /// What to keep in mind.
    pub note: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn one_member_and_other_slips_are_refused_by_key() {
        for (table, key) in [
            (json!({"b": 1}), "b"),
            (json!({"b": 0}), "b"),
            (json!({"b": 1001}), "b"),
            (json!({"frames": 0}), "frames"),
            (json!({"width": 0}), "width"),
            (json!({"width": 1281}), "width"),
            (json!({"steps": 0}), "steps"),
            (json!({"scale": 0}), "scale"),
            (json!({"field": {"levls": 8}}), "field.levls"),
        ] {
            let params: BootstrapParams = serde_json::from_value(table).unwrap();
            let error = params.check().unwrap_err();
            assert_eq!(error.path, key, "{error:?}");
        }
    }
}
