//! Tones of points that several photos show: how far photos differ, and the exposure of each.

use serde::{Deserialize, Serialize};

/// What matched points say of the photos' exposures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tones {
    /// How far photos differ.
    pub difference: ToneDifference,
    /// The exposures, sorted by id. Empty if the photos need none.
    pub photos: Vec<PhotoTone>,
}

/// How far photos differ in the tones of the points that they share.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToneDifference {
    /// Points that two photos or more show.
    pub points: u64,
    /// Difference between photos, as a share of the mean tone. Measured at points that the exposures were not solved from.
    pub spread: f64,
    /// The same once each photo has its own gain and offset.
    pub noise: f64,
}

/// Exposure of a photo, which shows gain * colour + offset, channel by channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhotoTone {
    /// Id of the photo.
    pub id: String,
    /// Natural logarithm of the gain of each channel.
    pub log_gain: [f64; 3],
    /// Added after the gain, sRGB with white = 1.
    pub offset: [f64; 3],
}

impl ToneDifference {
    /// Photos need exposures of their own if they differ by this multiple of the noise at least: exposures then explain three quarters of
    /// the variance. Where they explain 57 % of it (`fox4`: 5.5 % and 3.6 %) they cost 0.6 dB after 400 steps.
    const LEAST_RATIO: f64 = 2.0;
    /// Least difference that matters, as a share of the mean tone. With a mean of 0.4 it is an error of 34 dB.
    const LEAST_SPREAD: f64 = 0.05;

    /// Returns whether photos differ by more than noise, and by so much that it matters.
    pub fn is_real(&self) -> bool {
        self.spread > Self::LEAST_SPREAD.max(Self::LEAST_RATIO * self.noise)
    }

    /// Returns the difference in words.
    #[must_use]
    pub fn words(&self) -> String {
        format!(
            "tones differ by {:.1} % between photos at {} matched points, {:.1} % with a gain and an offset each",
            100.0 * self.spread,
            self.points,
            100.0 * self.noise
        )
    }
}
