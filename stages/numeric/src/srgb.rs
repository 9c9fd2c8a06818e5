//! The curve of sRGB.

/// Returns the linear light of an sRGB value, both in [0, 1] (IEC 61966-2-1): c / 12.92, or ((c + 0.055) / 1.055)^2.4.
///
/// x^2.4 is x² (x²)^(1/5), and the fifth root comes from Newton's method, from above: monotonic, 60 steps reach the last bit. No
/// transcendental function: the same bits on every machine.
pub fn linear_light(srgb: f64) -> f64 {
    if srgb <= 0.040_45 {
        return srgb / 12.92;
    }
    let base = (srgb + 0.055) / 1.055;
    let square = base * base;
    let mut root = 1.0;
    for _ in 0..60 {
        let fourth = root * root * root * root;
        root -= (fourth * root - square) / (5.0 * fourth);
    }
    square * root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_agrees_with_the_power_function() {
        for step in 0..=1000 {
            let value = f64::from(step) / 1000.0;
            let exact = if value <= 0.040_45 {
                value / 12.92
            } else {
                ((value + 0.055) / 1.055).powf(2.4)
            };
            let found = linear_light(value);
            assert!((found - exact).abs() < 1e-14, "{value}: {found} {exact}");
        }
    }
}
