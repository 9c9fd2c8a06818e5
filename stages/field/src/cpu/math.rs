//! Own exponential functions: libm differs between platforms, polynomials do not.

/// Adding and subtracting it rounds |x| < 2^22 to the nearest integer (1.5 * 2^23).
const ROUND: f32 = 12_582_912.0;

/// Returns e^x, relative error below 2e-7 for x in [-87, 88]. Outside, the value at the border.
///
/// Cody-Waite reduction by ln 2 in two parts, polynomial of degree 6 (Cephes `expf`).
/// NaN gives a finite number: count NaN before.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let x = x.clamp_to(-87.0, 88.0);
    let shifted = x.mul_add(std::f32::consts::LOG2_E, ROUND);
    let k = shifted - ROUND;
    let r = k.mul_add(-0.693_145_75, x);
    let r = k.mul_add(-1.428_606_8e-6, r);
    let p = 1.987_569_1e-4_f32
        .mul_add(r, 1.398_199_9e-3)
        .mul_add(r, 8.333_452e-3)
        .mul_add(r, 4.166_579_6e-2)
        .mul_add(r, 1.666_666_5e-1)
        .mul_add(r, 0.5);
    let p = (p * r).mul_add(r, r) + 1.0;
    // The integer is in the low bits of `shifted`. ROUND itself is 0x4B40_0000.
    let exponent = shifted.to_bits().wrapping_sub(0x4B40_0000).wrapping_add(127) << 23;
    p * f32::from_bits(exponent)
}

/// Returns 1 - e^-x for x >= 0, relative error below 3e-7 also where x is tiny. 1 above 87.
#[inline(always)]
pub fn one_minus_exp_neg(x: f32) -> f32 {
    // Below 0.5 the series x - x^2/2 + ... to x^9. Above, 1 - e^-x loses at most one bit.
    let series = (1.0 / 362_880.0_f32)
        .mul_add(x, -1.0 / 40_320.0)
        .mul_add(x, 1.0 / 5_040.0)
        .mul_add(x, -1.0 / 720.0)
        .mul_add(x, 1.0 / 120.0)
        .mul_add(x, -1.0 / 24.0)
        .mul_add(x, 1.0 / 6.0)
        .mul_add(x, -0.5);
    let small = (series * x).mul_add(x, x);
    let large = 1.0 - exp(-x);
    if x < 0.5 { small } else { large }
}

/// Returns 1 / (1 + e^-x).
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// `clamp` as two selects, without the assertion on the bounds.
trait ClampTo {
    fn clamp_to(self, low: Self, high: Self) -> Self;
}

impl ClampTo for f32 {
    #[inline(always)]
    fn clamp_to(self, low: f32, high: f32) -> f32 {
        let above = if self > low { self } else { low };
        if above < high { above } else { high }
    }
}

/// Returns the n-th root of `ratio` >= 1 by bisection with products only: the same bits on every platform.
pub fn root(ratio: f64, n: u32) -> f64 {
    let power = |base: f64| (0..n).fold(1.0, |product, _| product * base);
    let (mut low, mut high) = (1.0_f64, ratio.max(1.0));
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if power(middle) < ratio {
            low = middle;
        } else {
            high = middle;
        }
    }
    if n == 0 { 1.0 } else { high }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every 997th float of a range, signs included.
    fn floats(low: f32, high: f32) -> impl Iterator<Item = f32> {
        let bits = (0..u32::MAX / 997).map(|k| f32::from_bits(k * 997));
        bits.filter(move |x| *x >= low && *x <= high)
    }

    #[test]
    fn exp_is_within_2e_7_of_f64_everywhere() {
        for x in floats(-87.0, 88.0) {
            let truth = f64::from(x).exp();
            let error = (f64::from(exp(x)) - truth).abs() / truth;
            assert!(error < 2e-7, "exp({x}): {} against {truth}, {error}", exp(x));
        }
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(
            (exp(f32::NEG_INFINITY), exp(f32::INFINITY)),
            (exp(-87.0), exp(88.0))
        );
        assert!(exp(f32::NAN).is_finite());
    }

    #[test]
    fn one_minus_exp_neg_keeps_every_digit_of_a_thin_sample() {
        for x in floats(1e-30, 1e30) {
            let truth = -(-f64::from(x)).exp_m1();
            let error = (f64::from(one_minus_exp_neg(x)) - truth).abs() / truth;
            assert!(
                error < 3e-7,
                "1 - exp(-{x}): {} against {truth}",
                one_minus_exp_neg(x)
            );
        }
        assert_eq!(one_minus_exp_neg(0.0), 0.0);
        assert_eq!(one_minus_exp_neg(f32::MAX), 1.0);
    }

    #[test]
    fn sigmoid_agrees_with_f64_and_is_one_half_at_zero() {
        for x in floats(-30.0, 30.0) {
            let truth = 1.0 / (1.0 + (-f64::from(x)).exp());
            let error = (f64::from(sigmoid(x)) - truth).abs() / truth;
            assert!(error < 4e-7, "sigmoid({x}): {error}");
        }
        assert_eq!(sigmoid(0.0), 0.5);
    }

    #[test]
    fn the_seventh_root_of_2187_is_3() {
        assert!((root(2187.0, 7) - 3.0).abs() < 1e-12);
        assert_eq!((root(1.0, 7), root(5.0, 0)), (1.0, 1.0));
    }
}
