//! One resampling of a photo to the ideal pinhole of its camera model.

use marf_scene::{Cahvor, CahvorError, Camera, Image, Pinhole, Srgb};
use marf_stage::Cancel;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Returns the photo as the pinhole would have taken it.
///
/// Each pixel's line of sight is projected through `model` (normalised) into the photo and the 8-bit sRGB
/// values are interpolated there with the cubic of Catmull and Rom (a = -1/2, 4 x 4 pixels, edges repeated),
/// rounded half up and held in 0..=255. One resampling at the photo's own scale: what an average of light would
/// change within one pixel is below the 8-bit step except at hard edges.
///
/// The lens equations of CAHVORE end in functions whose last bit differs between machines. A position off by 1e-13 px changes a rounded
/// value once in about 1e12.
///
/// # Errors
/// A pixel of the pinhole for which the model has none, or `None` if `cancel`, which is checked at each row, is set.
pub(crate) fn resample(
    photo: &Image<Srgb>,
    model: &Cahvor,
    pinhole: &Pinhole,
    cancel: &Cancel,
) -> Result<Image<Srgb>, Option<CahvorError>> {
    let camera = &pinhole.camera;
    let frame_from_cam = pinhole.cam_from_frame.rotation.transpose();
    resample_by(photo, [camera.width, camera.height], cancel, |pixel| {
        let direction = frame_from_cam * direction(camera, pixel);
        let (x, y) = (pixel.x, pixel.y);
        model
            .project_direction(&direction)
            .ok_or(CahvorError::Blind { x, y })
    })
}

/// Returns a picture of another geometry, interpolated as by [`resample`]. `source` returns the position in the photo of the centre of a
/// pixel. Whole numbers are pixel centres.
///
/// # Errors
/// The first of `source`, by rows, or `None` if `cancel`, which is checked at each row, is set.
pub(crate) fn resample_by<E: Send>(
    photo: &Image<Srgb>,
    size_px: [u32; 2],
    cancel: &Cancel,
    source: impl Fn(&Vector2<f64>) -> Result<Vector2<f64>, E> + Sync,
) -> Result<Image<Srgb>, Option<E>> {
    let [width, height] = size_px;
    let row = |row: u32| {
        if cancel.is_set() {
            return Err(None);
        }
        let pixel = |column: u32| {
            let centre = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            Ok(sample(photo, &source(&centre).map_err(Some)?))
        };
        (0..width).map(pixel).collect()
    };
    let rows: Result<Vec<Vec<[u8; 3]>>, Option<E>> = (0..height).into_par_iter().map(row).collect();
    Ok(Image {
        width,
        height,
        pixels: rows?.concat(),
    })
}

/// Returns the direction (z = 1) in which an ideal pinhole sees a pixel.
pub(crate) fn direction(pinhole: &Camera, pixel: &Vector2<f64>) -> Vector3<f64> {
    Vector3::new(
        (pixel.x - pinhole.cx_px) / pinhole.fx_px,
        (pixel.y - pinhole.cy_px) / pinhole.fy_px,
        1.0,
    )
}

/// Interpolates at a position where whole numbers are pixel centres.
fn sample(photo: &Image<Srgb>, position: &Vector2<f64>) -> [u8; 3] {
    let (left, top) = (position.x.floor(), position.y.floor());
    let (across, down) = (weights(position.x - left), weights(position.y - top));
    let columns = neighbours(left, photo.width);
    let rows = neighbours(top, photo.height);
    let mut sums = [0.0_f64; 3];
    for (row, down) in rows.into_iter().zip(down) {
        for (column, across) in columns.into_iter().zip(across) {
            let weight = down * across;
            for (sum, channel) in sums.iter_mut().zip(photo.at(column, row)) {
                *sum += weight * f64::from(channel);
            }
        }
    }
    sums.map(|sum| (sum + 0.5).floor().clamp(0.0, 255.0) as u8)
}

/// The four pixels around a position, edges repeated.
fn neighbours(first: f64, len: u32) -> [u32; 4] {
    let last = f64::from(len.saturating_sub(1));
    [-1.0, 0.0, 1.0, 2.0].map(|step| (first + step).clamp(0.0, last) as u32)
}

/// Weights of the cubic for a fraction in [0, 1). They sum to 1 and are (0, 1, 0, 0) at 0.
fn weights(t: f64) -> [f64; 4] {
    [
        t * (t * (1.0 - 0.5 * t) - 0.5),
        1.0 + t * t * (1.5 * t - 2.5),
        t * (0.5 + t * (2.0 - 1.5 * t)),
        t * t * (0.5 * t - 0.5),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_hit_the_pixels() {
        assert_eq!(weights(0.0), [0.0, 1.0, 0.0, 0.0]);
        for t in [0.0, 1e-12, 0.25, 0.5, 0.75, 1.0 - 1e-12] {
            let sum: f64 = weights(t).iter().sum();
            assert!((sum - 1.0).abs() < 1e-15, "{t}: {sum}");
        }
        // Half way between pixels: (-1, 9, 9, -1) / 16.
        assert_eq!(weights(0.5), [-0.0625, 0.5625, 0.5625, -0.0625]);
    }

    #[test]
    fn a_ramp_is_met_between_pixels_and_the_edge_is_repeated() {
        let ramp = Image::from_fn(20, 10, |x, y| [(x * 10) as u8, (y * 20) as u8, 255]);
        assert_eq!(sample(&ramp, &Vector2::new(7.5, 4.25)), [75, 85, 255]);
        assert_eq!(sample(&ramp, &Vector2::new(0.0, 0.0)), [0, 0, 255]);
        assert_eq!(sample(&ramp, &Vector2::new(19.0, 9.0)), [190, 180, 255]);
        assert_eq!(sample(&ramp, &Vector2::new(1e9, -1e9)), [190, 0, 255]);
    }

    #[test]
    fn an_overshoot_is_held_in_the_bytes() {
        let step = Image::from_fn(8, 8, |x, _| [if x < 4 { 0 } else { 255 }; 3]);
        assert_eq!(sample(&step, &Vector2::new(2.5, 3.0)), [0; 3]);
        assert_eq!(sample(&step, &Vector2::new(4.5, 3.0)), [255; 3]);
    }
}
