//! A photo of a lens as an ideal pinhole would have taken it.

use std::f64::consts::FRAC_PI_2;

use marf_scene::{Camera, Image, Srgb};
use marf_stage::Cancel;
use nalgebra::{Matrix2, Vector2};

use super::distortion::Distortion;
use crate::resample::{direction, resample_by};

/// Farthest that the pinhole reaches from the principal point, as a multiple of the photo. A fisheye sees more than any plane shows.
const MOST_GROWTH: f64 = 2.0;
/// Largest radius in the plane z = 1 of a lens other than a fisheye: 87° off the axis.
const MOST_RADIUS: f64 = 20.0;

/// A lens with its inverse.
pub(crate) struct Undistorter {
    /// Focal lengths, principal point and size of the photo, without distortion.
    photo: Camera,
    distortion: Distortion,
    /// Where the inverse ends.
    reach: f64,
    /// Camera of the resampled photo.
    pub pinhole: Camera,
}

/// Direction of a place in the photo.
enum Direction {
    /// Place in the plane z = 1.
    Plane(Vector2<f64>),
    /// 90° and more off the axis: no plane shows it.
    Aside,
}

impl Undistorter {
    /// Returns the undistorter of a lens: `photo` has its focal lengths, principal point and size.
    ///
    /// The pinhole keeps the scale in the middle. It is the largest whose every pixel was seen, in whole pixels of the photo. It reaches at
    /// most twice as far from the principal point as the photo.
    ///
    /// # Errors
    /// A lens without inverse at the rim of the photo, or a pinhole of no pixel.
    pub fn new(photo: Camera, distortion: Distortion) -> Result<Self, String> {
        let reach = match distortion {
            Distortion::Fisheye(_) => distortion.reach(FRAC_PI_2),
            _ => distortion.reach(MOST_RADIUS),
        };
        let mut undistorter = Self {
            photo,
            distortion,
            reach,
            pinhole: photo,
        };
        undistorter.pinhole = undistorter.largest_pinhole()?;
        Ok(undistorter)
    }

    /// Returns an image of the photo's size, or its mask, as the pinhole sees it.
    ///
    /// # Errors
    /// A pixel of the pinhole that the lens does not see, or `None` if `cancel` is set.
    pub fn resample(
        &self,
        image: &Image<Srgb>,
        cancel: &Cancel,
    ) -> Result<Image<Srgb>, Option<Vector2<f64>>> {
        let size_px = [self.pinhole.width, self.pinhole.height];
        resample_by(image, size_px, cancel, |pixel| {
            let seen = self.pixel(&direction(&self.pinhole, pixel).xy());
            Ok(seen.ok_or(*pixel)? - Vector2::repeat(0.5))
        })
    }

    /// Returns the pixel of the photo that shows a point of the plane z = 1, or `None` where the lens has no inverse.
    fn pixel(&self, plane: &Vector2<f64>) -> Option<Vector2<f64>> {
        let radius = plane.norm();
        let radius = match self.distortion {
            Distortion::Fisheye(_) => radius.atan(),
            _ => radius,
        };
        let seen = self.distortion.distort(plane);
        let camera = &self.photo;
        let at = Vector2::new(
            camera.fx_px * seen.x + camera.cx_px,
            camera.fy_px * seen.y + camera.cy_px,
        );
        (radius <= self.reach).then_some(at)
    }

    fn largest_pinhole(&self) -> Result<Camera, String> {
        let camera = &self.photo;
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let along = |length: u32| (0..=length).map(f64::from);
        // As far as the growth allows, from the principal point.
        let (mut left, mut right) = (
            camera.cx_px * (1.0 - MOST_GROWTH),
            camera.cx_px + MOST_GROWTH * (width - camera.cx_px),
        );
        for y in along(camera.height) {
            left = left.max(self.straight(0.0, y)?.x);
            right = right.min(self.straight(width, y)?.x);
        }
        let (mut top, mut bottom) = (
            camera.cy_px * (1.0 - MOST_GROWTH),
            camera.cy_px + MOST_GROWTH * (height - camera.cy_px),
        );
        for x in along(camera.width) {
            top = top.max(self.straight(x, 0.0)?.y);
            bottom = bottom.min(self.straight(x, height)?.y);
        }
        // Whole pixels: the last bits of an arc tangent differ between machines.
        let (left, top) = (left.ceil(), top.ceil());
        let (columns, rows) = (right.floor() - left, bottom.floor() - top);
        if columns < 1.0 || rows < 1.0 {
            return Err("the lens leaves no picture without distortion".to_owned());
        }
        Ok(Camera {
            width: columns as u32,
            height: rows as u32,
            cx_px: camera.cx_px - left,
            cy_px: camera.cy_px - top,
            ..*camera
        })
    }

    /// Returns the undistorted position of a pixel of the photo, pixels. Infinite where no plane shows it.
    fn straight(&self, x: f64, y: f64) -> Result<Vector2<f64>, String> {
        let camera = &self.photo;
        let seen = Vector2::new(
            (x - camera.cx_px) / camera.fx_px,
            (y - camera.cy_px) / camera.fy_px,
        );
        let no_inverse = || format!("its lens has no inverse at ({x}, {y}) px, {:?}", self.distortion);
        Ok(match self.undistort(&seen).ok_or_else(no_inverse)? {
            Direction::Plane(plane) => Vector2::new(
                camera.fx_px * plane.x + camera.cx_px,
                camera.fy_px * plane.y + camera.cy_px,
            ),
            Direction::Aside => seen.map(|side| if side == 0.0 { 0.0 } else { side * f64::INFINITY }),
        })
    }

    /// Inverts [`Distortion::distort`]. `None` where it has no inverse.
    fn undistort(&self, seen: &Vector2<f64>) -> Option<Direction> {
        match self.distortion {
            Distortion::Fisheye(_) => self.angle(seen.norm()).map(|angle| {
                let factor = if angle > 0.0 {
                    angle.tan() / seen.norm()
                } else {
                    1.0
                };
                if angle < FRAC_PI_2 {
                    Direction::Plane(seen * factor)
                } else {
                    Direction::Aside
                }
            }),
            _ => self.newton(seen).map(Direction::Plane),
        }
    }

    /// Returns the angle off the axis that a fisheye shows at a radius: bisection, as the radius grows with the angle.
    fn angle(&self, seen: f64) -> Option<f64> {
        let radius = |angle: f64| angle * self.distortion.radial(angle).0;
        if radius(self.reach) <= seen {
            return (self.reach >= FRAC_PI_2).then_some(FRAC_PI_2);
        }
        let (mut low, mut high) = (0.0, self.reach);
        // 60 halvings of π/2 end at 1e-18.
        for _ in 0..60 {
            let middle = f64::midpoint(low, high);
            if radius(middle) < seen {
                low = middle
            } else {
                high = middle
            }
        }
        Some(low)
    }

    /// Returns the place that the lens moves to `seen`, by Newton's method with central differences.
    fn newton(&self, seen: &Vector2<f64>) -> Option<Vector2<f64>> {
        const STEP: f64 = 1e-6;
        let lens = |plane: &Vector2<f64>| self.distortion.distort(plane);
        let mut plane = *seen;
        for _ in 0..Camera::NEWTON_STEPS {
            let error = lens(&plane) - seen;
            if error.amax() < 1e-14 {
                break;
            }
            let along = |axis: Vector2<f64>| {
                (lens(&(plane + axis * STEP)) - lens(&(plane - axis * STEP))) / (2.0 * STEP)
            };
            let slope = Matrix2::from_columns(&[along(Vector2::x()), along(Vector2::y())]);
            plane -= slope.try_inverse()? * error;
        }
        let is_closed = (lens(&plane) - seen).amax() < 1e-9;
        (is_closed && plane.norm() <= self.reach).then_some(plane)
    }
}

#[cfg(test)]
mod tests {
    use super::super::distortion::Rational;
    use super::*;

    fn photo() -> Camera {
        Camera {
            fy_px: 64.0,
            cx_px: 62.0,
            ..Camera::pinhole(120, 90, 65.0)
        }
    }

    /// Barrel and pincushion.
    fn browns() -> [Distortion; 2] {
        [
            Distortion::Brown([-0.25, 0.06, 0.002, -0.001]),
            Distortion::Brown([0.12, -0.02, 0.0, 0.0]),
        ]
    }

    fn lenses() -> [Distortion; 5] {
        let [barrel, pincushion] = browns();
        [
            barrel,
            pincushion,
            Distortion::Rational(Rational {
                numerator: [-0.2, 0.04, -0.002, 0.0005],
                denominator: [0.02, 0.001, 0.0],
                tangential: [0.001, -0.002],
            }),
            Distortion::Fisheye([0.02, -0.01, 0.003, -0.0004]),
            Distortion::Fisheye([0.0; 4]),
        ]
    }

    #[test]
    fn a_direction_comes_back_to_its_place() {
        for lens in lenses() {
            let undistorter = Undistorter::new(photo(), lens).unwrap();
            for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.7, 0.5), (1e-9, 0.0)] {
                let plane = Vector2::new(x, y);
                let Some(Direction::Plane(again)) = undistorter.undistort(&lens.distort(&plane)) else {
                    panic!("{lens:?} has no inverse at {plane}");
                };
                assert!((again - plane).norm() < 1e-9, "{lens:?} {plane} {again}");
            }
        }
    }

    #[test]
    fn straight_lines_are_straight_again() {
        let grating = |plane: &Vector2<f64>| {
            [(127.5 + 90.0 * ((plane.x + 0.3 * plane.y) * 9.0).sin()).round() as u8; 3]
        };
        for lens in lenses() {
            let undistorter = Undistorter::new(photo(), lens).unwrap();
            let taken = Image::from_fn(120, 90, |column, row| {
                let camera = photo();
                let seen = Vector2::new(
                    (f64::from(column) + 0.5 - camera.cx_px) / camera.fx_px,
                    (f64::from(row) + 0.5 - camera.cy_px) / camera.fy_px,
                );
                match undistorter.undistort(&seen) {
                    Some(Direction::Plane(plane)) => grating(&plane),
                    _ => [0; 3],
                }
            });
            let straight = undistorter.resample(&taken, &Cancel::default()).unwrap();
            let pinhole = undistorter.pinhole;
            assert_eq!((straight.width, straight.height), (pinhole.width, pinhole.height));
            for row in 2..pinhole.height - 2 {
                for column in 2..pinhole.width - 2 {
                    let pixel = Vector2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                    let expected = grating(&direction(&pinhole, &pixel).xy())[0];
                    let found = straight.at(column, row)[0];
                    // A wave of 45 pixels, interpolated with a cubic and rounded twice. Towards the rim a fisheye packs it closer.
                    assert!(
                        found.abs_diff(expected) <= 6,
                        "{lens:?} {column} {row}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn no_pixel_is_invented_and_two_more_rows_or_columns_would_be() {
        for lens in browns() {
            let undistorter = Undistorter::new(Camera::pinhole(120, 90, 65.0), lens).unwrap();
            let pinhole = undistorter.pinhole;
            let inside = |x: f64, y: f64| {
                let seen = undistorter.pixel(&direction(&pinhole, &Vector2::new(x, y)).xy());
                seen.is_some_and(|seen| {
                    (-1e-6..=120.0 + 1e-6).contains(&seen.x) && (-1e-6..=90.0 + 1e-6).contains(&seen.y)
                })
            };
            let (width, height) = (f64::from(pinhole.width), f64::from(pinhole.height));
            let rim = |length: f64| (0..=100).map(move |step| f64::from(step) / 100.0 * length);
            for x in rim(width) {
                assert!(inside(x, 0.0) && inside(x, height), "{lens:?} {x}");
            }
            for y in rim(height) {
                assert!(inside(0.0, y) && inside(width, y), "{lens:?} {y}");
            }
            assert!(rim(height).any(|y| !inside(width + 2.0, y)), "{lens:?}");
            assert!(rim(width).any(|x| !inside(x, height + 2.0)), "{lens:?}");
        }
    }

    #[test]
    fn a_fisheye_of_more_than_a_half_space_ends_at_twice_the_photo() {
        // 38 px a radian: the left edge is 93° off the axis.
        let wide = Camera {
            fx_px: 38.0,
            fy_px: 38.0,
            ..photo()
        };
        let undistorter = Undistorter::new(wide, Distortion::Fisheye([0.0; 4])).unwrap();
        assert_eq!(
            (undistorter.pinhole.width, undistorter.pinhole.cx_px),
            (240, 124.0)
        );
    }

    #[test]
    fn a_lens_that_folds_inside_the_photo_is_refused() {
        let folds = Rational {
            numerator: [-1.0, 0.0, 0.001, 0.0],
            ..Rational::default()
        };
        let error = Undistorter::new(photo(), folds.simplest()).err().unwrap();
        assert!(error.contains("no inverse"), "{error}");
    }
}
