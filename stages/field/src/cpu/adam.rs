//! Adam that skips rows without a gradient and counts the steps of every row.

use super::simd::{Isa, Kernel};

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
        let weights = self.weights.as_chunks_mut::<F>().0.iter_mut();
        let gradient = self.gradient.as_chunks_mut::<F>().0.iter_mut();
        let first = self.moments.first.as_chunks_mut::<F>().0.iter_mut();
        let second = self.moments.second.as_chunks_mut::<F>().0.iter_mut();
        let rows = weights.zip(gradient).zip(first).zip(second).zip(&mut self.moments.count);
        for ((((w, g), m), v), count) in rows {
            let mut touched = 0_u32;
            for f in 0..F {
                touched |= g[f].to_bits() << 1; // both zeros
            }
            if touched == 0 {
                continue;
            }
            let [c1, c2] = self.bias.0[(*count as usize).min(DEBIASED - 1)];
            *count = count.saturating_add(1);
            for f in 0..F {
                let slope = self.decay.mul_add(w[f], g[f]);
                m[f] = BETA1.mul_add(m[f], (1.0 - BETA1) * slope);
                v[f] = BETA2.mul_add(v[f], (1.0 - BETA2) * (slope * slope));
                let root = (v[f] * c2).sqrt() + self.epsilon;
                w[f] -= self.rate * (m[f] * c1) / root;
                g[f] = 0.0;
            }
        }
    }
}
