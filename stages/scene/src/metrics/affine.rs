use super::comparable::{Hidden, MetricError, check};
use super::psnr::{open, psnr};
use crate::{Image, Srgb};

/// Returns the PSNR in dB after the render was given the photo's exposure: the gain and the offset of each channel that minimise the
/// squared error. Pixels are then rounded to 8 bits. It is not a score of the exposure, and at least [`psnr`] but for rounding.
///
/// # Extremes
/// A channel in which the render is constant becomes the photo's mean.
///
/// # Errors
/// As [`psnr`].
pub fn psnr_affine(
    render: &Image<Srgb>,
    photo: &Image<Srgb>,
    hidden: Hidden<'_>,
) -> Result<f64, MetricError> {
    check(render, photo, 1)?;
    let tables = [0, 1, 2].map(|channel| fitted(render, photo, hidden, channel));
    let pixel = |rgb: &[u8; 3]| [0, 1, 2].map(|channel| tables[channel][usize::from(rgb[channel])]);
    let exposed = Image {
        width: render.width,
        height: render.height,
        pixels: render.pixels.iter().map(pixel).collect(),
    };
    psnr(&exposed, photo, hidden)
}

/// Returns the values that those of a render become in a channel. All sums are exact.
fn fitted(render: &Image<Srgb>, photo: &Image<Srgb>, hidden: Hidden<'_>, channel: usize) -> [u8; 256] {
    let (mut count, mut sums, mut xx, mut xy) = (0_u64, [0_u64; 2], 0_u64, 0_u64);
    for (index, rgb) in open(&render.pixels, hidden) {
        let [x, y] = [rgb, &photo.pixels[index]].map(|rgb| u64::from(rgb[channel]));
        (count, sums) = (count + 1, [sums[0] + x, sums[1] + y]);
        (xx, xy) = (xx + x * x, xy + x * y);
    }
    let [mean_x, mean_y] = sums.map(|sum| sum as f64 / count.max(1) as f64);
    let variance = xx as f64 / count.max(1) as f64 - mean_x * mean_x;
    let covariance = xy as f64 / count.max(1) as f64 - mean_x * mean_y;
    let gain = if variance > 1e-9 {
        covariance / variance
    } else {
        0.0
    };
    let mut table = [0; 256];
    for (value, becomes) in table.iter_mut().enumerate() {
        *becomes = (mean_y + gain * (value as f64 - mean_x) + 0.5).clamp(0.0, 255.0) as u8;
    }
    table
}
