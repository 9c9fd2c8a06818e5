//! The quadrature of the volume-rendering integral in log space, forward and backward.
//!
//! C = sum_i T_i (1 - exp(-tau_i)) c_i + T_S b, T_i = exp(-sum_{j<i} tau_j) (NeRF, arXiv 2003.08934, eq. 3).

use super::math::{exp, one_minus_exp_neg, sigmoid};
use super::simd::{Block, Isa, Kernel, LANES};

/// Raw densities are cut here: exp(11) is opaque at any step. The gradient above is zero.
pub const RAW_LIMIT: f32 = 11.0;
/// Added to the raw density before the exponential, so that untrained space is thin.
pub const RAW_SHIFT: f32 = -3.0;
/// Logits of colours are cut at +-10 (0.99995, beyond 8 bits). The gradient outside is zero.
pub const LOGIT_LIMIT: f32 = 10.0;
/// Samples behind a transmittance below this are left out. The error of a colour is at most this.
pub const OPAQUE: f32 = 1e-4;

/// tau = exp(raw) delta, and alpha = 1 - exp(-tau), sample by sample.
pub struct Depths<'a> {
    /// Raw outputs of the density network.
    pub raw: &'a [f32],
    /// Length of the sample in the contracted box.
    pub delta: &'a [f32],
    /// Optical depth.
    pub tau: &'a mut [f32],
    /// Opacity.
    pub alpha: &'a mut [f32],
}

impl Kernel for Depths<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let inputs = self.raw.iter().zip(self.delta);
        let outputs = self.tau.iter_mut().zip(self.alpha.iter_mut());
        for ((raw, delta), (tau, alpha)) in inputs.zip(outputs) {
            let cut = if *raw < RAW_LIMIT { *raw } else { RAW_LIMIT };
            *tau = exp(cut + RAW_SHIFT) * *delta;
            *alpha = one_minus_exp_neg(*tau);
        }
    }
}

/// Densities of raw outputs, not cut. NaN where one is not finite.
pub struct Densities<'a> {
    /// Raw outputs of the density network, as many as `found` or more.
    pub raw: &'a [f32],
    /// Receives the densities.
    pub found: &'a mut [f32],
}

impl Kernel for Densities<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        for (found, raw) in self.found.iter_mut().zip(self.raw) {
            let density = exp(*raw + RAW_SHIFT);
            *found = if raw.is_finite() { density } else { f32::NAN };
        }
    }
}

/// Replaces numbers by e to the minus of them.
pub struct ExpNeg<'a>(pub &'a mut [f32]);

impl Kernel for ExpNeg<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        for value in self.0 {
            *value = exp(-*value);
        }
    }
}

/// Colours of the logits in the first three columns of rows of one block.
pub struct Colours<'a> {
    /// `[n]`, one block a row.
    pub logits: &'a [Block],
    /// `[n]`, sRGB in [0, 1]. The fourth number is unused.
    pub rgb: &'a mut [[f32; 4]],
}

impl Kernel for Colours<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        // Four rows are one vector.
        let rows = self.logits.chunks(4).zip(self.rgb.chunks_mut(4));
        for (logits, rgb) in rows {
            let mut values = [0.0; LANES];
            for (row, values) in logits.iter().zip(values.chunks_exact_mut(4)) {
                values.copy_from_slice(&row.0[..4]);
            }
            for lane in 0..LANES {
                values[lane] = colour(values[lane]);
            }
            for (rgb, values) in rgb.iter_mut().zip(values.as_chunks().0) {
                *rgb = *values;
            }
        }
    }
}

/// Returns the colour of one logit.
#[inline(always)]
pub fn colour(logit: f32) -> f32 {
    let below = if logit < LOGIT_LIMIT { logit } else { LOGIT_LIMIT };
    sigmoid(if below > -LOGIT_LIMIT { below } else { -LOGIT_LIMIT })
}

/// Returns the slope of [`colour`], from its value.
#[inline(always)]
pub fn colour_slope(logit: f32, value: f32) -> f32 {
    let inside = logit.abs() < LOGIT_LIMIT;
    if inside { value * (1.0 - value) } else { 0.0 }
}

/// The samples of one ray.
#[derive(Clone, Copy)]
pub struct Ray<'a> {
    /// Opacities.
    pub alpha: &'a [f32],
    /// Transmittances before the samples.
    pub transmittance: &'a [f32],
    /// Colours.
    pub rgb: &'a [[f32; 4]],
    /// Numbers of the steps along the ray, as a share of all steps, for the distortion loss.
    pub place: &'a [f32],
}

/// What a ray gathers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gathered {
    /// sum_i w_i c_i.
    pub rgb: [f32; 3],
    /// Transmittance behind the last sample.
    pub left: f32,
}

/// Composites front to back. An empty ray lets everything pass.
pub struct Gather<'a>(pub Ray<'a>);

impl Kernel for Gather<'_> {
    type Output = Gathered;

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) -> Gathered {
        self.0.gather()
    }
}

/// Writes the gradients of raw densities and colours, back to front.
///
/// dL/dtau_i = T_{i+1} q_i - sum_{j>i} w_j q_j - T_S (g . b), where q_i = g . c_i plus the slope of the
/// distortion loss. Nothing is divided by 1 - alpha.
pub struct Spread<'a> {
    /// The samples.
    pub ray: Ray<'a>,
    /// dL/dC.
    pub slope: [f32; 3],
    /// Colour of the background.
    pub behind: [f32; 3],
    /// Weight of the distortion loss, for this ray, and length of a step in units of `place`.
    pub distortion: [f32; 2],
    /// Receives dL/dtau.
    pub d_tau: &'a mut [f32],
    /// Receives dL/dc.
    pub d_rgb: &'a mut [[f32; 4]],
}

impl Kernel for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let Self {
            ray, slope, behind, ..
        } = self;
        ray.spread(slope, behind, self.distortion, self.d_tau, self.d_rgb);
    }
}

impl Ray<'_> {
    /// Gathers a colour as [`Gather`] does.
    #[inline(always)]
    pub fn gather(&self) -> Gathered {
        let mut found = Gathered {
            rgb: [0.0; 3],
            left: 1.0,
        };
        for i in 0..self.alpha.len() {
            let weight = self.transmittance[i] * self.alpha[i];
            for channel in 0..3 {
                found.rgb[channel] = weight.mul_add(self.rgb[i][channel], found.rgb[channel]);
            }
            found.left = self.transmittance[i] - weight;
        }
        found
    }

    /// Spreads a slope as [`Spread`] does, with its fields in order.
    #[inline(always)]
    pub fn spread(
        &self,
        slope: [f32; 3],
        behind: [f32; 3],
        distortion: [f32; 2],
        d_tau: &mut [f32],
        d_rgb: &mut [[f32; 4]],
    ) {
        let n = self.alpha.len();
        let [strength, cell] = distortion;
        let (mut total, mut moment) = (0.0_f32, 0.0_f32);
        for i in 0..n {
            let weight = self.transmittance[i] * self.alpha[i];
            total += weight;
            moment = weight.mul_add(self.place[i], moment);
        }
        let left = if n == 0 {
            1.0
        } else {
            self.transmittance[n - 1] * (1.0 - self.alpha[n - 1])
        };
        let dot = |a: [f32; 3], b: [f32; 3]| a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]));
        let mut suffix = left * dot(slope, behind);
        let (mut after, mut after_moment) = (0.0_f32, 0.0_f32);
        for i in (0..n).rev() {
            let weight = self.transmittance[i] * self.alpha[i];
            let place = self.place[i];
            let before = total - after - weight;
            let before_moment = moment - after_moment - weight * place;
            let apart = place * (before - after) - before_moment + after_moment;
            let spread = strength * (2.0 * apart + weight * cell * (2.0 / 3.0));
            let [r, g, b, _] = self.rgb[i];
            let q = dot(slope, [r, g, b]) + spread;
            let next = self.transmittance[i] - weight;
            d_tau[i] = next * q - suffix;
            suffix = weight.mul_add(q, suffix);
            d_rgb[i] = [slope[0] * weight, slope[1] * weight, slope[2] * weight, 0.0];
            after += weight;
            after_moment = weight.mul_add(place, after_moment);
        }
    }
}

/// Numbers of this size count as not finite: 2^33 gradients below it add up to less than 2^63, whose square f32 still
/// holds as Adam's second moment. Those of a training that learns are below 1.
pub const RUNAWAY: f32 = 1_073_741_824.0;

/// Returns whether a number is NaN, infinite or of the size [`RUNAWAY`], by its bits.
#[inline(always)]
pub fn runs_away(value: f32) -> bool {
    value.to_bits() & UNSIGNED >= RUNAWAY.to_bits()
}

/// The bits of a float but its sign: they rise with the size, and those of a NaN are the greatest.
const UNSIGNED: u32 = 0x7fff_ffff;

/// Whether one of the numbers runs away.
pub struct Runaways<'a>(pub &'a [f32]);

impl Kernel for Runaways<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> bool {
        let (blocks, rest) = self.0.as_chunks();
        let (unsigned, mut most) = (isa.splat_u(UNSIGNED), isa.splat_u(0));
        for block in blocks {
            most = isa.max_u(most, isa.and_u(isa.bits(isa.load(&Block(*block))), unsigned));
        }
        let mut lanes = [0; LANES];
        isa.store_u(most, &mut lanes);
        lanes.into_iter().any(|bits| bits >= RUNAWAY.to_bits()) || rest.iter().any(|value| runs_away(*value))
    }
}
