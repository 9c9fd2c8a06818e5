use super::comparable::{Hidden, MetricError, check};
use super::psnr::{MIN_MSE, decibels, open};
use crate::{Image, Srgb};

/// Returns the PSNR in dB after the render was given the photo's exposure: the gain and the offset of each channel that minimise the
/// squared error. It does not judge the exposure, and is at least [`psnr`](super::psnr()).
///
/// Of photo y and render x the mean squared error is then var y - cov(x, y)² / var x, and var y where x is constant.
///
/// # Errors
/// As [`psnr`](super::psnr()).
pub fn psnr_affine(
    render: &Image<Srgb>,
    photo: &Image<Srgb>,
    hidden: Hidden<'_>,
) -> Result<f64, MetricError> {
    check(render, photo, 1)?;
    let mut errors = 0.0;
    for channel in 0..3 {
        let (mut count, mut sums) = (0, [0_u64; 5]);
        for (index, rgb) in open(&render.pixels, hidden) {
            let [x, y] = [rgb, &photo.pixels[index]].map(|rgb| u64::from(rgb[channel]));
            count += 1;
            let terms = sums.iter_mut().zip([x, y, x * x, x * y, y * y]);
            terms.for_each(|(sum, term)| *sum += term);
        }
        if count == 0 {
            return Err(MetricError::Hidden);
        }
        let [x, y, xx, xy, yy] = sums.map(|sum| sum as f64 / f64::from(count));
        let (variance, covariance) = (xx - x * x, xy - x * y);
        let explained = if variance > 1e-9 {
            covariance * covariance / variance
        } else {
            0.0
        };
        errors += yy - y * y - explained;
    }
    Ok(decibels(1.0 / (errors / (3.0 * 65_025.0)).max(MIN_MSE)))
}
