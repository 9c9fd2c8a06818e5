//! Adam that skips rows without a gradient and counts the steps of every row.

use super::simd::{Isa, Kernel, LANES};

/// Decay of the first moment.
const BETA1: f32 = 0.9;
/// Decay of the second moment.
const BETA2: f32 = 0.99;
/// 0.99^4096 is below 2^-58: from there on the bias is 1 in f32.
const DEBIASED: usize = 4096;

/// 1 / (1 - beta^n) for both moments, by step count.
#[derive(Clone, Debug)]
pub struct Bias(Vec<[f32; 2]>);

impl Default for Bias {
    fn default() -> Self {
        let (mut first, mut second) = (1.0_f64, 1.0_f64);
        let corrections = (0..DEBIASED).map(|_| {
            first *= f64::from(BETA1);
            second *= f64::from(BETA2);
            [(1.0 / (1.0 - first)) as f32, (1.0 / (1.0 - second)) as f32]
        });
        Self(corrections.collect())
    }
}

/// Moments and step counts of one tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Mean of the gradient, `[rows, F]`.
    pub first: Vec<f32>,
    /// Mean of its square, `[rows, F]`.
    pub second: Vec<f32>,
    /// Steps of every row, `[rows]`.
    pub count: Vec<u32>,
}

impl Moments {
    /// All zero, for `len` numbers in rows of `row`.
    pub fn new(len: usize, row: usize) -> Self {
        Self {
            first: vec![0.0; len],
            second: vec![0.0; len],
            count: vec![0; len / row.max(1)],
        }
    }
}

/// One step of Adam (Kingma and Ba, arXiv 1412.6980, algorithm 1) over rows of F numbers.
///
/// A row whose gradient is all zero keeps weights, moments and count: a dense pass would let an entry that was
/// touched once drift 10 step sizes. Gradients are set to zero on the way.
///
/// # Extremes
/// A gradient above 1.8e19 makes the second moment infinite and its row stands still from then on.
pub struct Adam<'a, const F: usize> {
    /// `[rows, F]`.
    pub weights: &'a mut [f32],
    /// `[rows, F]`, zero afterwards.
    pub gradient: &'a mut [f32],
    /// Moments and counts.
    pub moments: &'a mut Moments,
    /// Step size.
    pub rate: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
    /// Pulls weights to zero: this times the weight is added to its gradient.
    pub decay: f32,
    /// Corrections by step count.
    pub bias: &'a Bias,
}

impl<const F: usize> Kernel for Adam<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let (weights, last_weights) = self.weights.as_chunks_mut();
        let (gradient, last_gradient) = self.gradient.as_chunks_mut();
        let (first, last_first) = self.moments.first.as_chunks_mut();
        let (second, last_second) = self.moments.second.as_chunks_mut();
        let (counts, last_counts) = self.moments.count.split_at_mut(weights.len() * (LANES / F));
        let rates = [self.rate, self.epsilon, self.decay];
        let blocks = weights.iter_mut().zip(gradient).zip(first).zip(second);
        for ((((w, g), m), v), count) in blocks.zip(counts.chunks_exact_mut(LANES / F)) {
            step::<F>([w, g, m, v], count, rates, self.bias);
        }
        // Rows that do not fill a block go through one that is padded with zeros, which are rows without gradient.
        let mut numbers = [last_weights, last_gradient, last_first, last_second];
        let mut padded = [[0.0; LANES]; 4];
        for (padded, numbers) in padded.iter_mut().zip(&numbers) {
            padded[..numbers.len()].copy_from_slice(numbers);
        }
        let [w, g, m, v] = &mut padded;
        step::<F>([w, g, m, v], last_counts, rates, self.bias);
        for (padded, numbers) in padded.iter().zip(&mut numbers) {
            numbers.copy_from_slice(&padded[..numbers.len()]);
        }
    }
}

/// Moves the rows of one block that have a gradient. `rates`: step size, epsilon, pull to zero.
#[inline(always)]
fn step<const F: usize>(
    [weight, slope, mean, square]: [&mut [f32; LANES]; 4],
    count: &mut [u32],
    [rate, epsilon, decay]: [f32; 3],
    bias: &Bias,
) {
    let mut any = 0_u32;
    for lane in 0..LANES {
        any |= slope[lane].to_bits() << 1; // both zeros
    }
    if any == 0 {
        return;
    }
    let (mut c1, mut c2, mut moves) = ([1.0; LANES], [1.0; LANES], [0_u32; LANES]);
    for (row, count) in count.iter_mut().enumerate() {
        let lanes = row * F..row * F + F;
        let mut touched = 0_u32;
        for bits in &slope[lanes.clone()] {
            touched |= bits.to_bits() << 1;
        }
        let [first, second] = bias.0[(*count as usize).min(DEBIASED - 1)];
        c1[lanes.clone()].fill(first);
        c2[lanes.clone()].fill(second);
        moves[lanes].fill(touched);
        *count = count.saturating_add(u32::from(touched > 0));
    }
    for lane in 0..LANES {
        let moved = moves[lane] > 0;
        let d = decay.mul_add(weight[lane], slope[lane]);
        let m = BETA1.mul_add(mean[lane], (1.0 - BETA1) * d);
        let v = BETA2.mul_add(square[lane], (1.0 - BETA2) * (d * d));
        let root = (v * c2[lane]).sqrt() + epsilon;
        let w = weight[lane] - rate * (m * c1[lane]) / root;
        weight[lane] = if moved { w } else { weight[lane] };
        mean[lane] = if moved { m } else { mean[lane] };
        square[lane] = if moved { v } else { square[lane] };
    }
    *slope = [0.0; LANES];
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::simd::Level;

    /// Takes steps with these gradients of one row of 4 (all the same), returns the weight after each.
    fn path(gradients: &[f32], count: u32) -> Vec<f32> {
        let (mut weights, mut moments) = (vec![0.0; 4], Moments::new(4, 4));
        moments.count[0] = count;
        let bias = Bias::default();
        let steps = gradients.iter().map(|gradient| {
            let mut gradient = vec![*gradient; 4];
            Level::best().run(Adam::<4> {
                weights: &mut weights,
                gradient: &mut gradient,
                moments: &mut moments,
                rate: 1.0,
                epsilon: 1e-15,
                decay: 0.0,
                bias: &bias,
            });
            assert_eq!(gradient, [0.0; 4]);
            weights[0]
        });
        steps.collect()
    }

    #[test]
    fn the_first_step_is_one_rate_whatever_the_gradient() {
        for gradient in [1.0, -1e-3, 1e-6, 1e-12] {
            let moved = path(&[gradient], 0)[0];
            assert!(
                (moved + gradient.signum()).abs() < 1e-2,
                "gradient {gradient}: {moved}"
            );
        }
    }

    #[test]
    fn a_row_without_gradient_does_not_drift() {
        let mut gradients = vec![0.0; 200];
        gradients[0] = 1e-3;
        let path = path(&gradients, 0);
        assert_eq!(path[0], path[199]);
    }

    #[test]
    fn two_steps_agree_with_the_textbook_in_f64() {
        let (g1, g2) = (0.5_f64, -0.2_f64);
        let (m1, v1) = (0.1 * g1, 0.01 * g1 * g1);
        let w1 = -(m1 / 0.1) / (v1 / 0.01).sqrt();
        let (m2, v2) = (0.9 * m1 + 0.1 * g2, 0.99 * v1 + 0.01 * g2 * g2);
        let w2 = w1 - (m2 / (1.0 - 0.81)) / (v2 / (1.0 - 0.9801)).sqrt();
        let found = path(&[g1 as f32, g2 as f32], 0);
        // 1 - 0.99 is only known to 5e-6 in f32.
        assert!(
            (f64::from(found[1]) - w2).abs() < 1e-5,
            "{} against {w2}",
            found[1]
        );
    }

    #[test]
    fn a_huge_gradient_stops_its_row_and_gives_no_nan() {
        let found = path(&[1e25, 1.0, 1.0], 0);
        assert!(found.iter().all(|weight| weight.is_finite()), "{found:?}");
        assert!(path(&[1.0], u32::MAX)[0].is_finite());
    }
}
