//! Conversion of light to 8-bit sRGB, the same for every photo, so that photos of one set stay comparable.

use std::sync::OnceLock;

use marf_numeric::linear_light;

/// Spectral radiance that becomes white, W / (m2 sr nm).
///
/// Half the radiance of a white surface under the mean sun of Mars at 550 nm. It is above that of the brightest dust,
/// which reflects a third of the light in the red. In the Mastcam-Z scenes measured, 99.5 % of the samples are below
/// 0.055, on the calibration target in the sun 93 % below 0.1.
pub const WHITE_RADIANCE: f64 = 0.125;

/// Returns the sRGB code of light in [0, 1]. Below and NaN is 0, above 255.
///
/// Rounds half up in code space, by comparison with 255 thresholds: no transcendental function, same code everywhere.
pub fn code(light: f32) -> u8 {
    let thresholds = thresholds();
    thresholds.partition_point(|threshold| *threshold <= light) as u8
}

/// Returns the light at which code k - 1 becomes k, for k = 1..=255.
fn thresholds() -> &'static [f32; 255] {
    static TABLE: OnceLock<[f32; 255]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|index| linear_light((index as f64 + 0.5) / 255.0) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_codes_come_out() {
        // 0.2140 is the light of code 127.5 (sRGB), 0.0031308 the knee at 10.3.
        for (light, expected) in [
            (0.0, 0),
            (1.0, 255),
            (0.2122, 127),
            (0.2159, 128),
            (0.003_130_8, 10),
            (0.5, 188),
        ] {
            assert_eq!(code(light), expected, "{light}");
        }
    }

    #[test]
    fn the_extremes_are_black_or_white() {
        for (light, expected) in [
            (f32::NAN, 0),
            (f32::NEG_INFINITY, 0),
            (-1.0, 0),
            (f32::MIN_POSITIVE, 0),
            (f32::INFINITY, 255),
            (f32::MAX, 255),
        ] {
            assert_eq!(code(light), expected, "{light}");
        }
    }
}
