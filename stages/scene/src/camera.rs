//! Pinhole cameras with lens distortion.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// A pinhole camera with OpenCV's radial and tangential distortion (all zero: an ideal pinhole).
///
/// x = X/Z, y = Y/Z, r² = x² + y²,
/// x' = x (1 + k1 r² + k2 r⁴) + 2 p1 x y + p2 (r² + 2 x²),
/// y' = y (1 + k1 r² + k2 r⁴) + p1 (r² + 2 y²) + 2 p2 x y.
///
/// The pixel is (fx x' + cx, fy y' + cy) (OpenCV, camera calibration and 3D reconstruction, and COLMAP's `OPENCV`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx_px: f64,
    /// Focal length along y, pixels.
    pub fy_px: f64,
    /// Column of the principal point, pixels from the left edge, possibly outside the image.
    pub cx_px: f64,
    /// Row of the principal point, pixels from the top edge, possibly outside the image.
    pub cy_px: f64,
    /// Radial distortion, factor of r².
    #[serde(default)]
    pub k1: f64,
    /// Radial distortion, factor of r⁴.
    #[serde(default)]
    pub k2: f64,
    /// Tangential distortion, first term.
    #[serde(default)]
    pub p1: f64,
    /// Tangential distortion, second term.
    #[serde(default)]
    pub p2: f64,
}

impl Camera {
    /// Most Newton steps for inverting the distortion.
    pub const NEWTON_STEPS: usize = 20;

    /// Returns an ideal pinhole with its principal point at the centre.
    pub fn pinhole(width: u32, height: u32, focal_px: f64) -> Self {
        let (cx_px, cy_px) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
        Self {
            width,
            height,
            fx_px: focal_px,
            fy_px: focal_px,
            cx_px,
            cy_px,
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
        }
    }

    /// Projects a point of the camera frame (x right, y down, z forward) to a pixel.
    ///
    /// Returns `None` behind the camera and where the distortion is no longer invertible.
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point.z <= 0.0 {
            return None;
        }
        let plane = Vector2::new(point.x / point.z, point.y / point.z);
        if !self.is_invertible(plane.norm_squared()) {
            return None;
        }
        let distorted = self.distort(&plane);
        Some(Vector2::new(
            self.fx_px * distorted.x + self.cx_px,
            self.fy_px * distorted.y + self.cy_px,
        ))
    }

    /// Returns the pixel of [`Camera::project`] if it is inside the photo.
    pub fn project_inside(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        let pixel = self.project(point)?;
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < width && pixel.y < height;
        inside.then_some(pixel)
    }

    /// Returns the viewing direction (z = 1) of a pixel, or `None` where the distortion has no inverse.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        let target = Vector2::new(
            (pixel.x - self.cx_px) / self.fx_px,
            (pixel.y - self.cy_px) / self.fy_px,
        );
        let mut plane = target;
        for _ in 0..Self::NEWTON_STEPS {
            let error = self.distort(&plane) - target;
            if error.amax() < 1e-14 {
                break;
            }
            plane -= self.newton_step(&plane, &error)?;
        }
        let closed = (self.distort(&plane) - target).amax() < 1e-9;
        (closed && self.is_invertible(plane.norm_squared())).then(|| Vector3::new(plane.x, plane.y, 1.0))
    }

    /// Returns the camera of the same photo at another size. The two axes may scale differently.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (
            f64::from(width) / f64::from(self.width),
            f64::from(height) / f64::from(self.height),
        );
        self.scaled(sx, sy, width, height)
    }

    /// Returns the camera of a photo reduced as by [`Image::box_reduced`](crate::Image::box_reduced).
    #[must_use]
    pub fn box_reduced(&self, factor: u32) -> Self {
        let scale = 1.0 / f64::from(factor.max(1));
        self.scaled(
            scale,
            scale,
            self.width / factor.max(1),
            self.height / factor.max(1),
        )
    }

    /// Returns the camera of a photo of this size from that of the photo [reduced](Self::box_reduced) by `factor`.
    #[must_use]
    pub fn unreduced(&self, factor: u32, [width, height]: [u32; 2]) -> Self {
        let scale = f64::from(factor.max(1));
        self.scaled(scale, scale, width, height)
    }

    /// Returns the camera that sees more or fewer rows, as many above as below. The other rows keep their content.
    #[must_use]
    pub fn with_height(&self, height: u32) -> Self {
        let moved = (f64::from(height) - f64::from(self.height)) / 2.0;
        Self {
            height,
            cy_px: self.cy_px + moved,
            ..*self
        }
    }

    /// Returns the squared distance of a pixel from the principal point, in focal lengths.
    pub fn radius2(&self, pixel: &Vector2<f64>) -> f64 {
        let (x, y) = (pixel.x - self.cx_px, pixel.y - self.cy_px);
        (x / self.fx_px).powi(2) + (y / self.fy_px).powi(2)
    }

    /// Returns [`Camera::radius2`] of the farthest corner.
    pub fn corner_radius2(&self) -> f64 {
        let sides =
            [0.0, f64::from(self.width)].map(|x| [0.0, f64::from(self.height)].map(|y| Vector2::new(x, y)));
        let corners = sides.as_flattened().iter();
        corners.map(|corner| self.radius2(corner)).fold(0.0, f64::max)
    }

    /// Returns whether every number is finite, the size is not zero and the focal lengths are positive.
    pub fn is_valid(&self) -> bool {
        let numbers = [
            self.fx_px, self.fy_px, self.cx_px, self.cy_px, self.k1, self.k2, self.p1, self.p2,
        ];
        let positive = self.fx_px > 0.0 && self.fy_px > 0.0 && self.width > 0 && self.height > 0;
        positive && numbers.iter().all(|number| number.is_finite())
    }

    /// Returns the camera with both axes scaled, for an image of this size.
    fn scaled(&self, sx: f64, sy: f64, width: u32, height: u32) -> Self {
        let (fx_px, fy_px) = (self.fx_px * sx, self.fy_px * sy);
        Self {
            width,
            height,
            fx_px,
            fy_px,
            cx_px: self.cx_px * sx,
            cy_px: self.cy_px * sy,
            ..*self
        }
    }

    /// Applies the distortion to a point of the plane z = 1.
    fn distort(&self, plane: &Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (plane.x, plane.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Returns the Newton step that reduces `error` at a point, or `None` where the Jacobian is singular.
    fn newton_step(&self, plane: &Vector2<f64>, error: &Vector2<f64>) -> Option<Vector2<f64>> {
        let (x, y) = (plane.x, plane.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * self.k2);
        let slope = 2.0 * (self.k1 + 2.0 * self.k2 * r2);
        let xx = radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x;
        let xy = slope * x * y + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        let yy = radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x;
        let determinant = xx * yy - xy * xy;
        (determinant.abs() > 1e-12)
            .then(|| Vector2::new(yy * error.x - xy * error.y, xx * error.y - xy * error.x) / determinant)
    }

    /// Returns whether the radial map r (1 + k1 r² + k2 r⁴) rises up to r, hence is invertible: 1 + 3 k1 r² + 5 k2 r⁴ > 0.
    fn is_invertible(&self, r2: f64) -> bool {
        let rises = |r2: f64| 1.0 + r2 * (3.0 * self.k1 + r2 * 5.0 * self.k2) > 0.0;
        // The slope is a parabola in r² and may be negative before r.
        let vertex = if self.k2 > 0.0 {
            (-0.3 * self.k1 / self.k2).clamp(0.0, r2)
        } else {
            0.0
        };
        rises(r2) && rises(vertex)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mock-up's camera, from the authors' transforms.json.
    fn rover() -> Camera {
        Camera {
            k1: 0.0943,
            k2: -0.1314,
            p1: 0.00125,
            p2: -0.00007,
            ..Camera::pinhole(1440, 1920, 1453.0)
        }
    }

    #[test]
    fn unproject_undoes_project_over_the_whole_photo() {
        for (x, y) in [(0.5, 0.5), (720.0, 960.0), (1439.5, 1919.5), (3.0, 1800.0)] {
            let pixel = Vector2::new(x, y);
            let ray = rover().unproject(&pixel).unwrap();
            let back = rover().project(&(ray * 7.0)).unwrap();
            assert!((back - pixel).norm() < 1e-9, "{x} {y}: {back}");
        }
    }

    #[test]
    fn behind_the_camera_and_beyond_the_fold_there_is_no_pixel() {
        assert_eq!(rover().project(&Vector3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(rover().project(&Vector3::new(0.0, 0.0, 0.0)), None);
        // k1 .0943, k2 -.1314 fold at r = 1.21.
        assert!(rover().project(&Vector3::new(1.19, 0.0, 1.0)).is_some());
        assert_eq!(rover().project(&Vector3::new(1.23, 0.0, 1.0)), None);
    }

    #[test]
    fn a_pixel_inside_is_on_the_photo_with_its_first_edges_and_without_its_last() {
        let camera = Camera::pinhole(8, 6, 2.0);
        let inside = |x: f64, y: f64| {
            let point = Vector3::new((x - camera.cx_px) / 2.0, (y - camera.cy_px) / 2.0, 1.0);
            camera.project_inside(&point).map(|pixel| [pixel.x, pixel.y])
        };
        assert_eq!(inside(0.0, 0.0), Some([0.0, 0.0]));
        assert_eq!(inside(7.5, 5.5), Some([7.5, 5.5]));
        for (x, y) in [(8.0, 3.0), (4.0, 6.0), (-0.5, 3.0), (4.0, -0.5)] {
            assert_eq!(inside(x, y), None, "{x}, {y}");
        }
    }

    #[test]
    fn a_reduced_camera_sees_the_same_ray_at_the_reduced_pixel() {
        let ray = rover().unproject(&Vector2::new(400.0, 800.0)).unwrap();
        let small = rover()
            .box_reduced(4)
            .unproject(&Vector2::new(100.0, 200.0))
            .unwrap();
        assert!((ray - small).norm() < 1e-12);
    }

    #[test]
    fn a_lower_picture_shows_the_middle_rows() {
        let low = rover().with_height(1000);
        let ray = |camera: &Camera, row| camera.unproject(&Vector2::new(400.0, row)).unwrap();
        // 1920 - 1000 rows are gone, 460 of them above.
        assert!((ray(&low, 40.0) - ray(&rover(), 500.0)).norm() < 1e-12);
        assert_eq!(rover().with_height(1920), rover());
    }
}
