use super::comparable::{Hidden, MetricError, check};
use super::logarithm::ln;
use crate::{Image, Srgb};

/// Smallest mean squared error that counts, with white = 1: equal images have 100 dB instead of infinity.
pub(super) const MIN_MSE: f64 = 1e-10;
/// Returns the peak signal-to-noise ratio in dB, with white as the peak: 10 log₁₀(1 / MSE), over the pixels that are not hidden.
///
/// MSE is the mean over pixels and channels of the squared difference of 8-bit sRGB values divided by 255. The
/// sum is exact (integers), the logarithm our own: equal images give equal bits on every machine.
///
/// # Extremes
/// Equal images give 100 dB (MSE is held at 1e-10 or more). Black against white gives 0 dB.
///
/// # Errors
/// Images of different size or without pixels.
pub fn psnr(a: &Image<Srgb>, b: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    Ok(decibels(1.0 / mean_squared_error(a, b, hidden)?))
}

/// Returns the paper's PSNR in dB, with the photo's largest value as the peak: 10 log₁₀(max(I²) / MSE).
///
/// I is the photo, 8-bit sRGB values divided by 255, the maximum over pixels and channels (MaRF, section
/// "Optimization"). Never above [`psnr`].
///
/// # Errors
/// Images of different size or without pixels, or a photo that is black everywhere.
pub fn psnr_paper(render: &Image<Srgb>, photo: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    let mse = mean_squared_error(render, photo, hidden)?;
    let open = open(&photo.pixels, hidden).map(|(_, rgb)| rgb);
    let peak = open.flatten().max().copied().unwrap_or(0);
    if peak == 0 {
        return Err(MetricError::NoPeak);
    }
    let peak = f64::from(peak) / 255.0;
    Ok(decibels(peak * peak / mse))
}

/// Returns the mean squared error with white = 1, at least [`MIN_MSE`].
fn mean_squared_error(a: &Image<Srgb>, b: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    check(a, b, 1)?;
    let square = |(a, b): (&u8, &u8)| u64::from(a.abs_diff(*b)).pow(2);
    let (mut sum, mut count) = (0_u64, 0_u64);
    for (index, a) in open(&a.pixels, hidden) {
        sum += a.iter().zip(&b.pixels[index]).map(square).sum::<u64>();
        count += 3;
    }
    if count == 0 {
        return Err(MetricError::Hidden);
    }
    Ok((sum as f64 / (count as f64 * 65_025.0)).max(MIN_MSE))
}

/// Returns the pixels that are not hidden, with their places.
pub(super) fn open<'a>(
    pixels: &'a [[u8; 3]],
    hidden: Hidden<'a>,
) -> impl Iterator<Item = (usize, &'a [u8; 3])> {
    let is_open = |(index, _): &(usize, &[u8; 3])| !hidden.get(*index).copied().unwrap_or(false);
    pixels.iter().enumerate().filter(is_open)
}

/// Returns a ratio of powers in decibels.
pub(super) fn decibels(ratio: f64) -> f64 {
    10.0 * ln(ratio) * std::f64::consts::LOG10_E
}
