//! The rules of `histogram` and their parameters.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::by_hand::ByHand;

/// Rejects photos whose brightness or colours differ too much from those of the other photos, and photos with lost
/// areas.
pub struct Histogram;

/// The rule of [`Histogram`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HistogramRule {
    /// Compares the distances to the median histograms of brightness and of two colour differences with those of the
    /// other photos. Also limits the shares of the photo that are flat, burnt out or black.
    Robust,
    /// The paper's rule: more than half of the bins of brightness are further than one standard deviation from
    /// the set's mean, the photo itself left out of both.
    Paper,
}

/// Parameters of [`Histogram`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HistogramParams {
    /// `robust` (default) or `paper`.
    pub rule: HistogramRule,
    /// Largest share of 8 x 8 blocks of one single brightness: areas lost in transmission, blocks, stripes. With
    /// `min_set` photos and more it is added to the upper quartile of the other photos of the instrument.
    pub max_flat: f64,
    /// Largest share of pixels without information: burnt out (a channel at 254 and more) or black (all at 4 and
    /// less). With `min_set` photos and more it is added to the upper quartile of the other photos of the instrument. Good photos of
    /// three cameras have 0.054 at most, a Navcam photo of burnt-out ground 0.40.
    pub max_clipped: f64,
    /// Distance of brightness to the median histogram, in 8-bit steps, up to which a photo is never
    /// rejected. A good Navcam photo in deep shadow is 67 away, an underexposed one of the demo 84, one of
    /// an eighth of the light 110.
    pub min_light: f64,
    /// The same for the two colour differences. Colours of good photos differ by this much.
    pub min_distance: f64,
    /// Largest distance: the median of the others' distances plus this multiple of (upper quartile - median).
    pub spreads: f64,
    /// Fewest photos of one instrument that are compared with each other. Of fewer, only `max_flat` and `max_clipped`
    /// reject.
    pub min_set: u32,
    /// Largest share of bins out of place, for `rule = "paper"`.
    pub max_bins: f64,
    /// Largest deviation of a bin, in standard deviations, for `rule = "paper"`.
    pub sigmas: f64,
    /// Photos kept or rejected by hand, filled from `[keep]` and `[reject]` of the pipeline.
    pub by_hand: ByHand,
}

impl Default for HistogramParams {
    fn default() -> Self {
        Self {
            rule: HistogramRule::Robust,
            max_flat: 0.2,
            max_clipped: 0.25,
            min_light: 75.0,
            min_distance: 24.0,
            spreads: 8.0,
            min_set: 5,
            max_bins: 0.5,
            sigmas: 1.0,
            by_hand: ByHand::default(),
        }
    }
}
