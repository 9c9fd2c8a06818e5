//! Intrinsics of a camera file.

use marf_scene::Camera;

use super::distortion::Distortion;

/// Largest width or height a camera may have, pixels.
pub(super) const MAX_SIDE_PX: u32 = 100_000;

/// Intrinsics as a file has them: size and focal length may be left to the photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    /// Width and height the other numbers are for, pixels. `None` means those of the photo.
    pub size: Option<(u32, u32)>,
    /// Focal lengths.
    pub focal: Focal,
    /// Principal point, pixels from the left edge. `None` means the middle.
    pub cx_px: Option<f64>,
    /// Principal point, pixels from the top edge. `None` means the middle.
    pub cy_px: Option<f64>,
    /// How it bends the picture.
    pub distortion: Distortion,
}

/// A focal length, one way or the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Focal {
    /// Along x and y, pixels.
    Px(f64, f64),
    /// Full angle of view along x and, if it differs from square pixels, along y, radians in (0, π).
    Angle(f64, Option<f64>),
}

impl Lens {
    /// Returns the camera of a photo of this size, without a distortion that [`Camera`] does not have.
    ///
    /// A photo whose size differs from the lens's is taken as enlarged or reduced if its sides have the same
    /// ratio within one pixel.
    ///
    /// # Errors
    /// Both sizes, if the ratio differs, or numbers that make no camera.
    pub fn camera(&self, width: u32, height: u32) -> Result<Camera, String> {
        let (w, h) = self.size.unwrap_or((width, height));
        let (own, photo) = ([w, h].map(f64::from), [width, height].map(f64::from));
        let along_y = own[1] * photo[0] / own[0] - photo[1];
        let along_x = own[0] * photo[1] / own[1] - photo[0];
        if along_x.abs().min(along_y.abs()) > 1.0 {
            return Err(format!(
                "the camera is for {w} x {h} pixels, the photo has {width} x {height}"
            ));
        }
        let (fx_px, fy_px) = match self.focal {
            Focal::Px(x, y) => (x, y),
            Focal::Angle(x, y) => {
                let fx_px = own[0] / 2.0 / tan(x / 2.0);
                (fx_px, y.map_or(fx_px, |y| own[1] / 2.0 / tan(y / 2.0)))
            }
        };
        let [k1, k2, p1, p2] = match self.distortion {
            Distortion::Brown(terms) => terms,
            Distortion::Rational(_) | Distortion::Fisheye(_) => [0.0; 4],
        };
        let camera = Camera {
            width: w,
            height: h,
            fx_px,
            fy_px,
            cx_px: self.cx_px.unwrap_or(own[0] / 2.0),
            cy_px: self.cy_px.unwrap_or(own[1] / 2.0),
            k1,
            k2,
            p1,
            p2,
        };
        let camera = if (w, h) == (width, height) {
            camera
        } else {
            camera.resized(width, height)
        };
        camera
            .is_valid()
            .then_some(camera)
            .ok_or_else(|| format!("no camera: {camera:?}"))
    }
}

/// Returns why a lens model is not read, and what to do.
pub(super) fn unread_lens(name: &str, read: &[&str]) -> String {
    format!(
        "the lens `{name}` is not read: supported are {}. `colmap image_undistorter` writes photos and cameras without distortion",
        read.join(", ")
    )
}

/// Returns the tangent of an angle in (0, π/2), from + - * / alone: focal lengths end in digests, and `tan` differs in its
/// last bit between machines. Taylor series to x²⁷, below 1e-20 at π/2.
fn tan(angle_rad: f64) -> f64 {
    let t = -angle_rad * angle_rad;
    let series = |odd: f64| {
        (1..14).rev().fold(1.0, |sum, k| {
            let k = 2.0 * f64::from(k);
            1.0 + sum * t / (k * (k + odd))
        })
    };
    angle_rad * series(1.0) / series(-1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        Lens {
            size: Some((1440, 1920)),
            focal: Focal::Px(1453.0, 1451.0),
            cx_px: Some(721.0),
            cy_px: Some(934.0),
            distortion: Distortion::Brown([0.09, -0.13, 0.001, 0.0]),
        }
    }

    #[test]
    fn our_tangent_is_the_libms() {
        for angle in [1e-9, 0.1, 0.345_555, 0.46, 0.8, 1.0, 1.4, 1.57] {
            let (ours, theirs) = (tan(angle), f64::tan(angle));
            // Near π/2 the cosine itself is small: its absolute error of 1e-16 weighs more.
            assert!(
                (ours / theirs - 1.0).abs() < 4e-16 * theirs.max(1.0),
                "{angle}: {ours} {theirs}"
            );
        }
    }

    #[test]
    fn a_photo_of_the_same_shape_gets_a_scaled_camera() {
        let camera = lens().camera(360, 480).unwrap();
        assert_eq!((camera.width, camera.height), (360, 480));
        assert_eq!(
            (camera.fx_px, camera.cx_px, camera.cy_px),
            (363.25, 180.25, 233.5)
        );
        assert_eq!(camera.k1, 0.09);
        // One pixel of rounding is accepted.
        assert!(lens().camera(360, 481).is_ok());
    }

    #[test]
    fn a_photo_of_another_shape_is_refused_with_both_sizes() {
        let error = lens().camera(1920, 1440).unwrap_err();
        assert_eq!(
            error,
            "the camera is for 1440 x 1920 pixels, the photo has 1920 x 1440"
        );
    }

    #[test]
    fn an_angle_becomes_a_focal_length_of_the_photo() {
        let lens = Lens {
            size: None,
            focal: Focal::Angle(0.691_111_207_008_361_8, None),
            cx_px: None,
            cy_px: None,
            distortion: Distortion::Brown([0.0; 4]),
        };
        let camera = lens.camera(400, 400).unwrap();
        // 200 / tan(0.3455556): the 555.5 px for 400 that the lego set is known for.
        assert!((camera.fx_px - 555.555_515).abs() < 1e-5, "{}", camera.fx_px);
        assert_eq!((camera.fy_px, camera.cx_px), (camera.fx_px, 200.0));
    }
}
