//! Adam that skips rows without a gradient and counts the steps of every row.

use super::simd::{Isa, Kernel};

/// Decay of the first moment.
pub const BETA1: f32 = 0.9;
/// Decay of the second moment.
pub const BETA2: f32 = 0.99;
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

impl Bias {
    /// Returns the corrections by step count. The last one holds for all later steps.
    pub fn corrections(&self) -> &[[f32; 2]] {
        &self.0
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
    /// Returns moments of zero for `len` numbers in rows of `row`.
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
/// A gradient above 1.8e19 makes the second moment infinite. Its row does not move from then on.
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
        let weights = self.weights.as_chunks_mut::<F>().0.chunks_mut(PIECE);
        let gradient = self.gradient.as_chunks_mut::<F>().0.chunks_mut(PIECE);
        let first = self.moments.first.as_chunks_mut::<F>().0.chunks_mut(PIECE);
        let second = self.moments.second.as_chunks_mut::<F>().0.chunks_mut(PIECE);
        let count = self.moments.count.chunks_mut(PIECE);
        let step = Step {
            rate: self.rate,
            epsilon: self.epsilon,
            decay: self.decay,
            bias: self.bias,
        };
        let pieces = weights.zip(gradient).zip(first).zip(second).zip(count);
        let mut is_sparse = false;
        for ((((w, g), m), v), count) in pieces {
            let (mut touched, mut found) = ([0_u8; PIECE], 0);
            if is_sparse {
                for (row, slopes) in g.iter().enumerate() {
                    touched[found % PIECE] = row as u8;
                    found += usize::from(is_touched(slopes));
                }
                for row in &touched[..found] {
                    let row = usize::from(*row);
                    step.take(
                        &mut w[row],
                        &mut g[row],
                        [&mut m[row], &mut v[row]],
                        &mut count[row],
                    );
                }
            } else {
                let rows = w.iter_mut().zip(g.iter_mut()).zip(m).zip(v).zip(count);
                for ((((w, g), m), v), count) in rows.filter(|((((_, g), _), _), _)| is_touched(g)) {
                    step.take(w, g, [m, v], count);
                    found += 1;
                }
            }
            is_sparse = found < PIECE * 7 / 8;
        }
    }
}

/// Rows that are moved together. Where more than an eighth of them have no gradient, they are listed before
/// any is moved. Without the list, the CPU mispredicts a branch a row and waits for the next rows one by one
/// (T = 2^18: 13.4 ms a step, 8.8 with it).
const PIECE: usize = 256;

/// Returns whether a row has a gradient. A zero of either sign is not one.
#[inline(always)]
fn is_touched<const F: usize>(slopes: &[f32; F]) -> bool {
    slopes.iter().fold(0, |bits, slope| bits | slope.to_bits() << 1) != 0
}

/// What a step is for all rows.
struct Step<'a> {
    rate: f32,
    epsilon: f32,
    decay: f32,
    bias: &'a Bias,
}

impl Step<'_> {
    /// Moves one row and sets its gradient to zero.
    #[inline(always)]
    fn take<const F: usize>(
        &self,
        w: &mut [f32; F],
        g: &mut [f32; F],
        [m, v]: [&mut [f32; F]; 2],
        count: &mut u32,
    ) {
        let [c1, c2] = self.bias.0[(*count as usize).min(DEBIASED - 1)];
        *count = count.saturating_add(1);
        // Rows are copied in and out so that the compiler may compute them as one vector.
        let (weight, slope, mut mean, mut square) = (*w, *g, *m, *v);
        let mut moved = [0.0; F];
        for f in 0..F {
            let slope = self.decay.mul_add(weight[f], slope[f]);
            mean[f] = BETA1.mul_add(mean[f], (1.0 - BETA1) * slope);
            square[f] = BETA2.mul_add(square[f], (1.0 - BETA2) * (slope * slope));
            let root = (square[f] * c2).sqrt() + self.epsilon;
            moved[f] = weight[f] - self.rate * (mean[f] * c1) / root;
        }
        (*w, *m, *v, *g) = (moved, mean, square, [0.0; F]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::simd::{InstructionSet, Run};

    /// Takes steps with these gradients of one row of 4 (all the same), returns the weight after each.
    fn path(gradients: &[f32], count: u32) -> Vec<f32> {
        let (mut weights, mut moments) = (vec![0.0; 4], Moments::new(4, 4));
        moments.count[0] = count;
        let bias = Bias::default();
        let steps = gradients.iter().map(|gradient| {
            let mut gradient = vec![*gradient; 4];
            InstructionSet::best().run(Adam::<4> {
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
