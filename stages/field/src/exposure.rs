//! Exposure of single photos: a photo shows gain * colour + offset, channel by channel. Vignetting is taken from photos before.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::cpu::math::exp;

/// Step size of log gains and offsets, as a share of the learning rate.
pub const RATE: f32 = 0.1;
/// Log gains stay within +-2 (2.9 stops), offsets within +-0.5, before their mean is taken away: a black photo
/// would pull its gain down without end and all others up.
pub const LIMITS: [f32; 2] = [2.0, 0.5];
/// Numbers of a photo in a row: three channels and one that is unused.
pub const ROW: usize = 4;

/// Whether every photo gets its own exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Gain {
    /// One log gain for each photo and channel. Its mean over all photos is 0 after every step.
    PerPhoto,
    /// A log gain and an offset for each photo and channel. Their means over all photos are 0 after every
    /// step.
    PerPhotoAndOffset,
    /// All photos share one exposure.
    Off,
}

/// Whether photos are darker towards their corners than the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Vignetting {
    /// They show the scene.
    #[default]
    Off,
    /// The darkening that matched points show is taken from the photos trained on, camera by camera. Pictures of the field are without it,
    /// and get it before they are compared with a photo.
    PerCamera,
}

/// How a photo changes a colour, gain * colour + offset. Also the slopes of the loss in log gain and offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// e^(log gain).
    pub gain: [f32; 3],
    /// Added after the gain, sRGB in [0, 1].
    pub offset: [f32; 3],
}

/// Exposure that a photo starts with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StartExposure {
    /// Natural logarithms of its gains.
    pub log_gain: [f32; 3],
    /// Added after the gain, sRGB in [0, 1].
    pub offset: [f32; 3],
}

/// Loss of one ray and its gradients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Squared errors of the channels.
    pub squares: [f32; 3],
    /// Slopes in the colour of the field.
    pub colour: [f32; 3],
    /// Slopes in log gain and offset.
    pub exposure: Exposure,
}

impl Exposure {
    /// Compares the field's colour, as this photo shows it, with a pixel. Slopes are those of half of `scale`
    /// times the squared error.
    #[inline(always)]
    pub fn compare(&self, plain: [f32; 3], pixel: [f32; 3], scale: f32) -> Comparison {
        let (mut squares, mut colour) = ([0.0; 3], [0.0; 3]);
        let (mut gain, mut offset) = ([0.0; 3], [0.0; 3]);
        for channel in 0..3 {
            let error = plain[channel].mul_add(self.gain[channel], self.offset[channel] - pixel[channel]);
            squares[channel] = error * error;
            colour[channel] = scale * error * self.gain[channel];
            gain[channel] = colour[channel] * plain[channel];
            offset[channel] = scale * error;
        }
        let exposure = Self { gain, offset };
        Comparison {
            squares,
            colour,
            exposure,
        }
    }
}

impl Gain {
    /// Returns how many numbers the exposures of all photos take: `[views, 4]` log gains, then as many offsets.
    pub fn numbers(self, views: usize) -> usize {
        match self {
            Self::Off | Self::PerPhoto => views * ROW,
            Self::PerPhotoAndOffset => 2 * views * ROW,
        }
    }
}

/// Cuts `[views, 4]` numbers at +-`limit`, then takes the mean of every channel away.
pub fn centre(numbers: &mut [f32], limit: f32) {
    numbers
        .iter_mut()
        .for_each(|number| *number = number.clamp(-limit, limit));
    let views = (numbers.len() / ROW) as f32;
    for channel in 0..3 {
        let mean = numbers.iter().skip(channel).step_by(ROW).sum::<f32>() / views;
        let row = numbers.iter_mut().skip(channel).step_by(ROW);
        row.for_each(|number| *number -= mean);
    }
}

/// Returns exposures of the same photos by which a scene of other colours looks the same: their log gains and their offsets have a mean of 0.
///
/// A colour c becomes e^m c + s, with m the mean log gain and s the sum of the offsets over that of the new gains.
pub fn centred(mut exposures: Vec<StartExposure>) -> Vec<StartExposure> {
    let count = exposures.len() as f32;
    for channel in 0..3 {
        let mean = exposures.iter().map(|one| one.log_gain[channel]).sum::<f32>() / count;
        let gains: Vec<f32> = exposures
            .iter()
            .map(|one| exp(one.log_gain[channel] - mean))
            .collect();
        let offsets: f32 = exposures.iter().map(|one| one.offset[channel]).sum();
        let shift = offsets / gains.iter().sum::<f32>();
        for (exposure, gain) in exposures.iter_mut().zip(gains) {
            exposure.log_gain[channel] -= mean;
            exposure.offset[channel] -= gain * shift;
        }
    }
    exposures
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_comparison_sends_back_the_slopes_of_its_f64_twin() {
        let (plain, pixel) = ([0.3_f32, 0.9, 0.0], [0.5_f32, 0.2, 0.7]);
        let (log_gain, offset) = ([0.2_f32, -0.7, 1.5], [0.1_f32, -0.05, 0.3]);
        let exposure = Exposure {
            gain: log_gain.map(exp),
            offset,
        };
        let found = exposure.compare(plain, pixel, 2.0);
        let loss =
            |at: [f64; 3], channel: usize| (at[0] * at[1].exp() + at[2] - f64::from(pixel[channel])).powi(2);
        for channel in 0..3 {
            let at = [plain[channel], log_gain[channel], offset[channel]].map(f64::from);
            let slopes = [
                found.colour[channel],
                found.exposure.gain[channel],
                found.exposure.offset[channel],
            ];
            for (index, slope) in slopes.into_iter().enumerate() {
                let moved = |by: f64| {
                    let mut at = at;
                    at[index] += by;
                    loss(at, channel)
                };
                let expected = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                let error = (f64::from(slope) - expected).abs();
                assert!(
                    error < 2e-5 * (1.0 + expected.abs()),
                    "{channel} {index}: {slope} against {expected}"
                );
            }
        }
    }

    #[test]
    fn a_photo_of_gain_2_and_offset_a_tenth_shows_a_fifth_as_a_half() {
        let exposure = Exposure {
            gain: [2.0; 3],
            offset: [0.1; 3],
        };
        let found = exposure.compare([0.2; 3], [0.5; 3], 1.0);
        assert!(found.squares.iter().all(|square| *square < 1e-12), "{found:?}");
    }

    /// Gains of 1 and 4 become 1/2 and 2, offsets of 0 and 0.5 lose 0.2 of each gain, and c becomes 2 c + 0.2.
    #[test]
    fn centred_exposures_show_the_same_photos_of_other_colours() {
        let exposure = |gain: f32, offset: f32| StartExposure {
            log_gain: [gain.ln(); 3],
            offset: [offset; 3],
        };
        let found = centred(vec![exposure(1.0, 0.0), exposure(4.0, 0.5)]);
        for (found, expected) in found.iter().zip([exposure(0.5, -0.1), exposure(2.0, 0.1)]) {
            let error = |a: f32, b: f32| (a - b).abs();
            assert!(error(found.log_gain[1], expected.log_gain[1]) < 1e-6, "{found:?}");
            assert!(error(found.offset[1], expected.offset[1]) < 1e-6, "{found:?}");
        }
        for (before, after) in [exposure(1.0, 0.0), exposure(4.0, 0.5)].iter().zip(&found) {
            let shown = |one: &StartExposure, color: f32| one.log_gain[2].exp() * color + one.offset[2];
            assert!((shown(before, 0.3) - shown(after, 0.8)).abs() < 1e-6);
        }
        assert_eq!(centred(vec![exposure(3.0, 0.2)]), [StartExposure::default()]);
    }

    #[test]
    fn numbers_are_cut_then_centred_whatever_they_were() {
        // Two photos, one driven far off: 2 and -2, whose mean is 0. The fourth number is never moved.
        let mut numbers = vec![50.0, 1.0, 0.0, 0.0, -7.0, 2.0, 0.0, 0.0];
        centre(&mut numbers, 2.0);
        assert_eq!(numbers, [2.0, -0.5, 0.0, 0.0, -2.0, 0.5, 0.0, 0.0]);
        // One photo alone has nothing to differ from.
        let mut alone = vec![1.5, -9.0, 0.25, 0.0];
        centre(&mut alone, 2.0);
        assert_eq!(alone, [0.0; 4]);
    }
}
