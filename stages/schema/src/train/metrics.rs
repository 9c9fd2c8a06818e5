//! Metrics and setup that `train` writes in addition to the weights.

use marf_cache::Digest;
use marf_field::{Config, Derived, Facts, Gain, Schedule};
use marf_scene::{Falloff, ToneDifference};
use serde::{Deserialize, Serialize};

use super::{Fit, Fold, Holdout, Memory, Target};
use crate::scores::Scores;

/// How well a field reproduces photos that it was trained on (the protocol of the paper). It says nothing
/// about other views.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OnTraining {
    /// Photos that were compared: as many as are held out, spread evenly over those trained on.
    pub photos: u64,
    /// Mean peak signal-to-noise ratio, peak 1, dB.
    pub psnr: f64,
    /// Mean of the paper's definition, peak = largest value of the photo, dB. `None` if all photos are black.
    pub psnr_paper: Option<f64>,
    /// Mean structural similarity. `None` if all photos are smaller than its window.
    pub ssim: Option<f64>,
}

/// Start of a training with `warm_start`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarmStart {
    /// The weights of this digest, of the node's last finished run.
    From(Digest),
    /// Nothing, and why.
    Cold(String),
}

/// Output `metrics` of `train`. Nothing in it comes from a clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// On the photos held out.
    #[serde(flatten)]
    pub scores: Scores,
    /// On some of the photos trained on. Only if those of the final metric are held out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on_training: Option<OnTraining>,
    /// How far photos differ in the tones of matched points, which decides whether they have exposures of their own. Absent if they share too
    /// few points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tones: Option<ToneDifference>,
    /// What matched points say of the vignetting of cameras, which decides whether it is taken into account.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vignetting: Vec<Falloff>,
    /// What it began from. Only with `warm_start`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_start: Option<WarmStart>,
    /// Result of `target_psnr`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<Target>,
    /// Optimiser steps.
    pub steps: u64,
    /// The end as planned during the training. Absent if it was planned once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<Schedule>,
    /// Rays trained.
    pub rays: u64,
    /// Samples trained.
    pub samples: u64,
    /// Mean squared error of the batches of the last eighth, sRGB in [0, 1].
    pub loss: f64,
    /// Factor by which photos were shrunk.
    pub scale: u32,
    /// Factor by which the photos that judge it were shrunk. Absent if the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged_scale: Option<u32>,
    /// One pixel in this many of each training photo was kept. Absent: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thinned: Option<u32>,
    /// Seed.
    pub seed: u64,
    /// Which photos were held out.
    pub holdout: Holdout,
    /// Which fold was held out instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fold: Option<Fold>,
    /// Photos trained on, each counted once.
    pub train_photos: u64,
    /// Photos held out.
    pub held_out_photos: u64,
    /// Ids of the photos trained on, repeated as drawn. Absent: each photo that the scene does not hold out, once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drawn: Option<Vec<String>>,
    /// What decided how large the field is.
    pub fit: Fit,
    /// The GPU that trained, with driver and interface. Absent: the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu: Option<String>,
    /// The configuration as it was used.
    pub config: Config,
    /// What the field was sized by.
    pub field: Facts,
}

impl Metrics {
    /// Returns in words whether photos have exposures of their own, and why.
    #[must_use]
    pub fn exposure(&self) -> Option<String> {
        let tones = self.tones?;
        let (is_on, is_needed) = (self.config.gain != Gain::Off, tones.is_real());
        let exposures = if is_on {
            "one for each photo"
        } else {
            "one for all photos"
        };
        let by_key = by_key("gain", is_on, is_needed);
        Some(format!("{exposures}{by_key}: {}", tones.words()))
    }

    /// Returns in words whether the vignetting of cameras is taken into account, and why.
    #[must_use]
    pub fn vignetting(&self) -> Option<String> {
        self.tones?;
        let is_on = self.config.vignetting != marf_field::Vignetting::Off;
        let is_needed = self.vignetting.iter().any(Falloff::is_real);
        let by_key = by_key("vignetting", is_on, is_needed);
        let switch = if is_on { "on" } else { "off" };
        let words: Vec<String> = self.vignetting.iter().map(Falloff::words).collect();
        let words = if words.is_empty() {
            "no camera has 4 photos with enough matched points at different distances from their middle"
                .to_owned()
        } else {
            words.join("; ")
        };
        Some(format!("{switch}{by_key}: {words}"))
    }

    /// Returns true if it trained on a photo that it did not hold out.
    pub fn has_drawn(&self, id: &str) -> bool {
        let is_it = |drawn: &Vec<String>| drawn.iter().any(|drawn| drawn == id);
        self.drawn.as_ref().is_none_or(is_it)
    }
}

/// Returns what has decided otherwise than matched points do.
fn by_key(key: &str, is_on: bool, is_needed: bool) -> String {
    if is_on == is_needed {
        return String::new();
    }
    format!(", as `field.{key}` or `fit` says")
}

/// Output `setup` of `train`: everything a training depends on except its scene, its seed and the draw of its
/// photos, including all derived and decided values.
///
/// A training that reads it through its port `training` is the same training with another seed or draw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// Optimiser steps.
    pub steps: u64,
    /// The end as planned during the training. Absent if it was planned once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<Schedule>,
    /// Whether one training photo in eight, by place, was held back to watch a target by.
    #[serde(default)]
    pub watched: bool,
    /// Factor by which photos are shrunk.
    pub scale: u32,
    /// One pixel in this many of each training photo is kept.
    pub kept_every: u32,
    /// Memory that the training may take.
    pub memory: Memory,
    /// Most training photos that are used. Absent: all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub photos: Option<u64>,
    /// Which photos are held out.
    pub holdout: Holdout,
    /// Which fold is held out instead.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fold: Option<Fold>,
    /// What it began from. Only with `warm_start`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_start: Option<WarmStart>,
    /// What decided how large the field is.
    pub fit: Fit,
    /// The configuration as it is used.
    pub config: Config,
    /// Box and sizes.
    pub derived: Derived,
}

impl Setup {
    /// Returns after how many steps the training ended, as it was planned.
    pub fn schedule(&self) -> Schedule {
        self.schedule
            .clone()
            .unwrap_or_else(|| Schedule::once(self.steps))
    }
}

/// Output `curve` of `train`: points in the order of steps.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Curve(pub Vec<CurvePoint>);

impl Curve {
    /// Held-out photos that a curve is measured on, at most: nine points cost a tenth of a draft.
    pub const MOST_PHOTOS: usize = 3;
    /// Their longest side, pixels.
    pub const SIDE_PX: u32 = 64;
}

/// A point of the training curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Optimiser steps so far.
    pub step: u64,
    /// Rays trained so far.
    pub rays: u64,
    /// Samples trained so far.
    pub samples: u64,
    /// Mean squared error of the batches since the last point, sRGB in [0, 1].
    pub loss: f64,
    /// Mean PSNR on up to [`Curve::MOST_PHOTOS`] held-out photos of at most [`Curve::SIDE_PX`] pixels a side, dB.
    pub psnr: f64,
}
