//! A photo as an ideal pinhole of the same place would have taken it.

use marf_scene::{Camera, Image, Srgb};
use marf_stage::Cancel;
use nalgebra::Vector2;

use crate::resample::{direction, resample_by};

/// Largest side of an undistorted photo, as a multiple of the photo's. A lens that needs more is refused.
const MOST_GROWTH: f64 = 2.0;

/// Returns the ideal pinhole for a camera. Its focal lengths are equal along each axis, so that pixels in the middle keep their scale.
///
/// Its size is the largest for which the camera saw every pixel (no black borders, as COLMAP's undistorter with `blank_pixels` 0). A camera
/// without distortion is returned as it is. `None` if the distortion has no inverse at the rim of the photo, or if the result is less than
/// a pixel or more than twice the photo.
pub fn ideal(camera: &Camera) -> Option<Camera> {
    if [camera.k1, camera.k2, camera.p1, camera.p2] == [0.0; 4] {
        return Some(*camera);
    }
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let straight = |x: f64, y: f64| {
        let seen = camera.unproject(&Vector2::new(x, y))?;
        Some(Vector2::new(
            camera.fx_px * seen.x + camera.cx_px,
            camera.fy_px * seen.y + camera.cy_px,
        ))
    };
    let along = |length: u32| (0..=length).map(f64::from);
    let (mut left, mut right) = (f64::NEG_INFINITY, f64::INFINITY);
    for y in along(camera.height) {
        left = left.max(straight(0.0, y)?.x);
        right = right.min(straight(width, y)?.x);
    }
    let (mut top, mut bottom) = (f64::NEG_INFINITY, f64::INFINITY);
    for x in along(camera.width) {
        top = top.max(straight(x, 0.0)?.y);
        bottom = bottom.min(straight(x, height)?.y);
    }
    let (columns, rows) = ((right - left).floor(), (bottom - top).floor());
    let is_sound = |side: f64, of: f64| side >= 1.0 && side <= MOST_GROWTH * of;
    (is_sound(columns, width) && is_sound(rows, height)).then_some(Camera {
        width: columns as u32,
        height: rows as u32,
        cx_px: camera.cx_px - left,
        cy_px: camera.cy_px - top,
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        ..*camera
    })
}

/// Returns a photo of `camera` as `pinhole` sees it.
///
/// # Errors
/// The pixel of the pinhole that the camera does not see, or `None` if `cancel` is set.
pub fn undistort(
    photo: &Image<Srgb>,
    camera: &Camera,
    pinhole: &Camera,
    cancel: &Cancel,
) -> Result<Image<Srgb>, Option<Vector2<f64>>> {
    resample_by(photo, [pinhole.width, pinhole.height], cancel, |pixel| {
        let source = camera.project(&direction(pinhole, pixel));
        Ok(source.ok_or(*pixel)? - Vector2::repeat(0.5))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lenses with all terms: barrel, pincushion, and one with its principal point aside.
    fn lenses() -> [Camera; 3] {
        let plain = Camera::pinhole(320, 240, 260.0);
        [
            Camera {
                k1: -0.25,
                k2: 0.06,
                p1: 0.002,
                p2: -0.001,
                ..plain
            },
            Camera {
                k1: 0.12,
                k2: -0.02,
                ..plain
            },
            Camera {
                fy_px: 255.0,
                cx_px: 148.0,
                cy_px: 131.0,
                k1: -0.18,
                p2: 0.003,
                ..plain
            },
        ]
    }

    /// Brightness of a slanted grating in the plane z = 1: its lines are straight in every pinhole.
    fn grating(x: f64, y: f64) -> [u8; 3] {
        let wave = |a: f64| (127.5 + 100.0 * (a * 24.0).sin()).round() as u8;
        [wave(x + 0.2 * y), wave(y - 0.3 * x), wave(x * 0.5 + y)]
    }

    fn taken_by(camera: &Camera) -> Image<Srgb> {
        Image::from_fn(camera.width, camera.height, |column, row| {
            let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let seen = camera.unproject(&pixel).unwrap();
            grating(seen.x, seen.y)
        })
    }

    #[test]
    fn straight_lines_are_straight_again() {
        for camera in lenses() {
            let pinhole = ideal(&camera).unwrap();
            let cancel = Cancel::default();
            let undistorted = undistort(&taken_by(&camera), &camera, &pinhole, &cancel).unwrap();
            let expected = taken_by(&pinhole);
            let worst = |a: &Image<Srgb>, b: &Image<Srgb>| {
                let pairs = a.pixels.as_flattened().iter().zip(b.pixels.as_flattened());
                pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap()
            };
            // A wave of 68 pixels, met by a cubic, and rounding twice.
            assert!(
                worst(&undistorted, &expected) <= 3,
                "{camera:?}: {}",
                worst(&undistorted, &expected)
            );
            // Without it the lens moves lines by many levels.
            let plain = Camera {
                k1: 0.0,
                k2: 0.0,
                p1: 0.0,
                p2: 0.0,
                ..camera
            };
            assert!(worst(&taken_by(&camera), &taken_by(&plain)) > 30, "{camera:?}");
        }
    }

    #[test]
    fn no_pixel_is_invented_and_the_next_row_or_column_would_be() {
        for camera in lenses() {
            let pinhole = ideal(&camera).unwrap();
            let inside = |x: f64, y: f64| {
                let seen = camera.project(&direction(&pinhole, &Vector2::new(x, y))).unwrap();
                (-1e-6..=320.0 + 1e-6).contains(&seen.x) && (-1e-6..=240.0 + 1e-6).contains(&seen.y)
            };
            let (width, height) = (f64::from(pinhole.width), f64::from(pinhole.height));
            let rim = |steps: f64| (0..=100).map(move |step| f64::from(step) / 100.0 * steps);
            for x in rim(width) {
                assert!(inside(x, 0.0) && inside(x, height), "{camera:?} {x}");
            }
            for y in rim(height) {
                assert!(inside(0.0, y) && inside(width, y), "{camera:?} {y}");
            }
            assert!(rim(height).any(|y| !inside(width + 1.0, y)), "{camera:?}");
            assert!(rim(width).any(|x| !inside(x, height + 1.0)), "{camera:?}");
        }
    }

    #[test]
    fn a_pinhole_stays_and_a_lens_without_inverse_is_refused() {
        let plain = Camera::pinhole(64, 48, 50.0);
        assert_eq!(ideal(&plain), Some(plain));
        let folded = Camera { k1: -2.0, ..plain };
        assert_eq!(ideal(&folded), None);
    }
}
