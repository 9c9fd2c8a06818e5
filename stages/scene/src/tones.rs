//! Tones of points that several photos show: how far photos differ, the exposure of each, and the vignetting of each camera.

use serde::{Deserialize, Serialize};

use crate::Camera;

/// What matched points say of the photos' exposures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tones {
    /// How far photos differ.
    pub difference: ToneDifference,
    /// The exposures, sorted by id. Empty if the photos need none.
    pub photos: Vec<PhotoTone>,
    /// What they say of the vignetting of cameras, solved before the exposures. Without cameras whose photos share too few points.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vignetting: Vec<Falloff>,
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

/// Vignetting of a camera: tones are v = 1 + a2 r² + a4 r⁴ + a6 r⁶ times as bright at r focal lengths from the principal point as there.
///
/// This is the form of JPL's flat fields (VICAR `RadiometryM20`) and of PPISP (arXiv 2601.18336), for tones in sRGB.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Falloff {
    /// The camera, by which its photos are known.
    pub camera: Camera,
    /// a2, a4 and a6.
    pub factors: [f64; 3],
    /// 1 - v at the farthest corner.
    pub darkening: f64,
    /// Its standard deviation, by a jackknife over groups of photos.
    pub sigma: f64,
    /// Pairs of tones that two photos give a point.
    pub pairs: u64,
    /// Difference of such tones, as a share, once the photos' exposures are taken away.
    pub spread: f64,
    /// The same with the vignetting that the other photos show taken away too.
    pub noise: f64,
}

impl Falloff {
    /// Least darkening that matters: two standard deviations less than was found is more than this.
    const LEAST_DARKENING: f64 = 0.05;
    /// Photos held back confirm it if it lowers their differences to this share at most.
    const MOST_NOISE: f64 = 0.95;
    /// v is not lower, whatever the factors.
    pub const LEAST: f64 = 0.1;

    /// Returns v where r² is `radius2`.
    pub fn at(&self, radius2: f64) -> f64 {
        let [a2, a4, a6] = self.factors;
        (1.0 + radius2 * (a2 + radius2 * (a4 + radius2 * a6))).max(Self::LEAST)
    }

    /// Returns whether corners are surely darker, and photos held back agree better for it.
    pub fn is_real(&self) -> bool {
        self.darkening - 2.0 * self.sigma > Self::LEAST_DARKENING
            && self.noise < Self::MOST_NOISE * self.spread
    }

    /// Returns the one of a camera, if it is real.
    pub fn real_one<'a>(all: &'a [Self], camera: &Camera) -> Option<&'a Self> {
        all.iter().find(|one| one.camera == *camera && one.is_real())
    }

    /// Returns what was found in words.
    #[must_use]
    pub fn words(&self) -> String {
        format!(
            "corners of {} x {} pixels are {:.1} ± {:.1} % darker than the middle, and photos held back differ by {:.2} % at {} pairs of matched points, {:.2} % without it",
            self.camera.width,
            self.camera.height,
            100.0 * self.darkening,
            100.0 * self.sigma,
            100.0 * self.spread,
            self.pairs,
            100.0 * self.noise
        )
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;

    /// 4 x 3 focal lengths wide: the corner is at r² = 2² + 1.5² = 6.25 of a centred camera, and at 16 + 2.25 of one whose principal point is
    /// on the left edge.
    #[test]
    fn v_is_the_polynomial_in_the_squared_distance_from_the_principal_point() {
        let camera = Camera::pinhole(40, 30, 10.0);
        assert_eq!(camera.corner_radius2(), 6.25);
        let edge = Camera { cx_px: 0.0, ..camera };
        assert_eq!(edge.corner_radius2(), 18.25);
        let radius2 = camera.radius2(&Vector2::new(30.0, 25.0));
        assert_eq!(radius2, 2.0);
        let falloff = Falloff {
            camera,
            factors: [-0.25, -0.125, 0.0625],
            darkening: 0.3,
            sigma: 0.01,
            pairs: 900,
            spread: 0.08,
            noise: 0.05,
        };
        // 1 - 0.5 - 0.5 + 0.5
        assert_eq!(falloff.at(radius2), 0.5);
        assert_eq!(falloff.at(0.0), 1.0);
        assert_eq!(
            Falloff {
                factors: [-9.0, 0.0, 0.0],
                ..falloff
            }
            .at(radius2),
            Falloff::LEAST
        );
    }

    #[test]
    fn a_falloff_is_real_if_it_is_sure_large_and_confirmed() {
        let falloff = Falloff {
            camera: Camera::pinhole(40, 30, 10.0),
            factors: [0.0; 3],
            darkening: 0.1,
            sigma: 0.01,
            pairs: 900,
            spread: 0.08,
            noise: 0.05,
        };
        assert!(falloff.is_real());
        assert_eq!(
            falloff.words(),
            "corners of 40 x 30 pixels are 10.0 ± 1.0 % darker than the middle, and photos held back differ by 8.00 % at 900 pairs of \
             matched points, 5.00 % without it"
        );
        assert_eq!(Falloff::real_one(&[falloff], &falloff.camera), Some(&falloff));
        assert_eq!(
            Falloff::real_one(&[falloff], &Camera::pinhole(40, 30, 11.0)),
            None
        );
        for not in [
            Falloff {
                sigma: 0.03,
                ..falloff
            },
            Falloff {
                darkening: 0.06,
                ..falloff
            },
            Falloff {
                darkening: -0.3,
                ..falloff
            },
            Falloff {
                sigma: f64::NAN,
                ..falloff
            },
            Falloff {
                noise: 0.079,
                ..falloff
            },
        ] {
            assert!(!not.is_real(), "{}", not.words());
            assert_eq!(Falloff::real_one(&[not], &not.camera), None);
        }
    }
}
