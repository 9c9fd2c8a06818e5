//! Conversion of a CAHV(OR(E)) model to an ideal pinhole.

use nalgebra::{Vector2, Vector3};

use super::{Cahvor, CahvorError, pose, vector};
use crate::{Camera, Pose};

/// Tangent of the largest angle off axis that is kept, 60 degrees: a flat image of more is mostly stretching.
const MAX_TANGENT: f64 = 1.732;
/// Most shear across the image, in pixels, that is neglected in a camera without skew.
const MAX_SHEAR_PX: f64 = 0.1;
/// Most times that the pinhole's image may be as wide or high as the photo.
const MAX_STRETCH: f64 = 4.0;
/// Fewest pixels a side of the pinhole's image.
const MIN_SIDE_PX: f64 = 16.0;

/// An ideal pinhole with the centre of projection of a CAHV(OR(E)) model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// The pinhole. Its first pixel centre is (0.5, 0.5), it has no distortion.
    pub camera: Camera,
    /// Its pose in the model's frame.
    pub cam_from_frame: Pose,
}

impl Cahvor {
    /// Returns the pinhole that has the pixels of this photo unchanged, if the model is one.
    ///
    /// `None` for a lens with radial terms, and where the axes shear by more than 0.1 px across the image: then
    /// see [`Cahvor::linearised`]. The principal point may be far outside the image (tiles).
    ///
    /// # Errors
    /// A model that [`Cahvor::normalised`] refuses.
    pub fn exact_pinhole(&self, width: u32, height: u32) -> Result<Option<Pinhole>, CahvorError> {
        let model = self.normalised()?;
        let k = model.intrinsics()?;
        let farthest = k.vc.abs().max((f64::from(height) - 1.0 - k.vc).abs());
        if !model.is_linear() || k.hs * k.skew.abs() * farthest / k.vs > MAX_SHEAR_PX {
            return Ok(None);
        }
        let camera = Camera {
            fx_px: k.hs * (1.0 - k.skew * k.skew).sqrt(),
            fy_px: k.vs,
            cx_px: k.hc + 0.5,
            cy_px: k.vc + 0.5,
            ..Camera::pinhole(width, height, k.hs)
        };
        Ok(Some(Pinhole {
            camera,
            cam_from_frame: k.cam_from_frame,
        }))
    }

    /// Returns the ideal pinhole whose every pixel this photo of `width` x `height` pixels can fill.
    ///
    /// It keeps C and looks along O (A without O), with rows along H, square pixels of focal length hs and a whole-numbered principal
    /// point, so that the last bits of the lens equations do not show. Its edges are the largest upright rectangle between the four borders
    /// of the photo, cut at 60 degrees off axis. It is exact for points far away. With CAHVORE a near point is off by the pupil's shift (4
    /// mm for a Navcam: 2.9 px at 1 m, 0.14 px at 20 m for f = 740 px).
    ///
    /// # Errors
    /// A model that [`Cahvor::normalised`] refuses, a border pixel without a line of sight, a pinhole that
    /// would be empty or more than four times as wide or high as the photo.
    pub fn linearised(&self, width: u32, height: u32) -> Result<Pinhole, CahvorError> {
        let model = self.normalised()?;
        let axes = Axes::new(&model);
        let focal_px = model.intrinsics()?.hs;
        let window = model.window(&axes, width, height)?;
        // Rounded inwards to whole pixels.
        let [left, top] = [window.min.x, window.min.y].map(|edge| (edge * focal_px).ceil());
        let [right, bottom] = [window.max.x, window.max.y].map(|edge| (edge * focal_px).floor());
        let size = [right - left, bottom - top];
        let fits = |size: f64, photo: u32| size >= MIN_SIDE_PX && size <= MAX_STRETCH * f64::from(photo);
        if !(fits(size[0], width) && fits(size[1], height)) {
            return Err(CahvorError::Stretched {
                width: size[0],
                height: size[1],
                photo: (width, height),
            });
        }
        let camera = Camera {
            cx_px: -left,
            cy_px: -top,
            ..Camera::pinhole(size[0] as u32, size[1] as u32, focal_px)
        };
        Ok(Pinhole {
            camera,
            cam_from_frame: pose(&axes.right, &axes.down, &axes.forward, &vector(model.c)),
        })
    }

    /// Returns the rectangle, at unit distance, between the four borders of the photo.
    fn window(&self, axes: &Axes, width: u32, height: u32) -> Result<Window, CahvorError> {
        let (last_x, last_y) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
        let mut window = Window {
            min: Vector2::repeat(-MAX_TANGENT),
            max: Vector2::repeat(MAX_TANGENT),
        };
        for y in (0..height).map(f64::from) {
            window.min.x = window.min.x.max(self.on_plane(axes, 0.0, y)?.x);
            window.max.x = window.max.x.min(self.on_plane(axes, last_x, y)?.x);
        }
        for x in (0..width).map(f64::from) {
            window.min.y = window.min.y.max(self.on_plane(axes, x, 0.0)?.y);
            window.max.y = window.max.y.min(self.on_plane(axes, x, last_y)?.y);
        }
        Ok(window)
    }

    /// Returns the position of a pixel in the plane at unit distance. Infinite from 90 degrees off axis.
    fn on_plane(&self, axes: &Axes, x: f64, y: f64) -> Result<Vector2<f64>, CahvorError> {
        let ray = self
            .unproject(&Vector2::new(x, y))
            .ok_or(CahvorError::Blind { x, y })?;
        let depth = ray.direction.dot(&axes.forward).max(0.0);
        Ok(Vector2::new(ray.direction.dot(&axes.right), ray.direction.dot(&axes.down)) / depth)
    }
}

/// An upright rectangle in the plane at unit distance.
struct Window {
    min: Vector2<f64>,
    max: Vector2<f64>,
}

/// The axes of the pinhole in the model's frame.
struct Axes {
    right: Vector3<f64>,
    down: Vector3<f64>,
    forward: Vector3<f64>,
}

impl Axes {
    /// Returns the axes for a normalised model: forward is O, or A for a model without lens terms.
    fn new(model: &Cahvor) -> Self {
        let forward = match model.o {
            Some(o) if !model.is_linear() => vector(o),
            _ => vector(model.a),
        };
        let along_rows = vector(model.h);
        let right = (along_rows - forward * along_rows.dot(&forward)).normalize();
        Self {
            right,
            down: forward.cross(&right),
            forward,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{cahvor, cahvore, mastcam_z, navcam_tile, near};
    use super::*;

    /// Every pixel of the pinhole is inside the photo, and shows what the photo shows there.
    #[test]
    fn the_ideal_pinhole_sees_what_the_photo_sees_and_nothing_else() {
        for (name, model, width, height) in [
            ("Mastcam-Z", mastcam_z(), 1648, 1200),
            ("Navcam tile", navcam_tile(), 1288, 976),
        ] {
            let pinhole = model.linearised(width, height).unwrap();
            let camera = pinhole.camera;
            let kept = f64::from(camera.width) * f64::from(camera.height) / f64::from(width * height);
            assert!(kept > 0.8, "{name}: {camera:?} keeps {kept}");
            let model = model.normalised().unwrap();
            let steps =
                (0..=40).flat_map(|x| (0..=40).map(move |y| (f64::from(x) / 40.0, f64::from(y) / 40.0)));
            for (x, y) in steps {
                let pixel = Vector2::new(
                    0.5 + x * f64::from(camera.width - 1),
                    0.5 + y * f64::from(camera.height - 1),
                );
                let ray = pinhole
                    .cam_from_frame
                    .inverse()
                    .direction(&camera.unproject(&pixel).unwrap());
                let source = model.project_direction(&ray).unwrap();
                let inside = source.x >= 0.0 && source.y >= 0.0;
                assert!(
                    inside && source.x <= f64::from(width - 1) && source.y <= f64::from(height - 1),
                    "{name}: {source}"
                );
                for range_m in [2.0, 30.0] {
                    let point = Vector3::from(model.c) + ray.normalize() * range_m;
                    let photo = model.project(&point).unwrap();
                    assert!(
                        (photo - source).norm() < 0.01,
                        "{name} {range_m} m: {photo} {source}"
                    );
                    let there = camera.project(&pinhole.cam_from_frame.point(&point)).unwrap();
                    assert!((there - pixel).norm() < 1e-8, "{name}: {there} {pixel}");
                }
            }
        }
    }

    #[test]
    fn an_ideal_pinhole_needs_no_resampling() {
        let plain = Cahvor {
            o: None,
            r: None,
            e: None,
            ..cahvor()
        };
        let pinhole = plain.exact_pinhole(1648, 1200).unwrap().unwrap();
        let point = Vector3::new(10.8, 0.66, -1.82);
        let pixel = pinhole
            .camera
            .project(&pinhole.cam_from_frame.point(&point))
            .unwrap();
        let there = plain.project(&point).unwrap();
        // Integer = centre there, 0.5 = first centre here.
        near((pixel - there).as_slice(), &[0.5, 0.5], 1e-9, "half a pixel");
        assert_eq!(cahvor().exact_pinhole(1648, 1200).unwrap(), None);
        // A shear of 1e-4 is 0.06 px over 600 rows, 1e-3 is 0.6 px.
        for (shear, exact) in [(1e-4, true), (1e-3, false)] {
            let sheared = Cahvor {
                h: [823.5, 14_800.0, 14_800.0 * shear],
                ..plain
            };
            assert_eq!(
                sheared.exact_pinhole(1648, 1200).unwrap().is_some(),
                exact,
                "{shear}"
            );
        }
    }

    #[test]
    fn a_fish_eye_is_cut_at_sixty_degrees_and_a_blind_pixel_is_named() {
        let camera = cahvore(0.0).linearised(1600, 1200).unwrap().camera;
        let (left, right) = (camera.cx_px, f64::from(camera.width) - camera.cx_px);
        assert!(left.max(right) <= 1.732 * camera.fx_px, "{camera:?}");
        let folding = Cahvor {
            r: Some([0.0, -1.0, 0.0]),
            ..cahvore(0.0)
        };
        let error = folding.linearised(1600, 1200).unwrap_err();
        assert!(matches!(error, CahvorError::Blind { .. }), "{error}");
    }
}
