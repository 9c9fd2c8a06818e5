//! Conversion of light to 8-bit sRGB, the same for every photo, so that photos of one set stay comparable.

use std::sync::OnceLock;

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
    TABLE.get_or_init(|| std::array::from_fn(|index| linear((index as f64 + 0.5) / 255.0) as f32))
}

/// Returns the light of an sRGB value (IEC 61966-2-1): c / 12.92, or ((c + 0.055) / 1.055)^2.4.
fn linear(code: f64) -> f64 {
    if code <= 0.04045 {
        return code / 12.92;
    }
    let base = (code + 0.055) / 1.055;
    let square = base * base;
    square * fifth_root(square) // x^2.4 = x^2 (x^2)^(1/5)
}

/// Returns the fifth root of a value in (0, 1] by Newton's method from above: monotonic, 60 steps reach the last bit.
fn fifth_root(value: f64) -> f64 {
    let mut root = 1.0;
    for _ in 0..60 {
        let fourth = root * root * root * root;
        root -= (fourth * root - value) / (5.0 * fourth);
    }
    root
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
    fn the_curve_agrees_with_the_power_function() {
        for step in 0..=1000 {
            let value = f64::from(step) / 1000.0;
            let exact = if value <= 0.04045 {
                value / 12.92
            } else {
                ((value + 0.055) / 1.055).powf(2.4)
            };
            assert!(
                (linear(value) - exact).abs() < 1e-14,
                "{value}: {} {exact}",
                linear(value)
            );
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
