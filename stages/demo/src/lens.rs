//! The camera model: CAHVOR, projection and back-projection.

use marf_scene::{Cahvor, Camera, Pose};

use super::math::{V3, Vector, v3};

/// A CAHVOR camera. Integer pixel = pixel centre, 0-based.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lens {
    pub c: V3,
    pub a: V3,
    pub h: V3,
    pub v: V3,
    pub o: V3,
    pub r: [f64; 3],
}

/// Radial distortion of the demo's lens: mild, as that of a wide rover camera.
const RADIAL: [f64; 3] = [0.0002, -0.035, 0.012];
const OPTICAL_TILT: (f64, f64) = (0.006, -0.004);

impl Lens {
    /// Returns a camera at `c` that looks along `forward`, with `right` along its rows.
    pub fn new(c: V3, forward: V3, right: V3, size_px: [u32; 2], focal_px: f64) -> Self {
        let down = forward.cross(&right);
        let centre = |side: u32| (f64::from(side) - 1.0) / 2.0;
        // The principal point is off centre, as that of every real camera.
        let hc = centre(size_px[0]) + 0.008 * focal_px;
        let vc = centre(size_px[1]) - 0.005 * focal_px;
        Self {
            c,
            a: forward,
            h: right * focal_px + forward * hc,
            v: down * focal_px + forward * vc,
            o: (forward + right * OPTICAL_TILT.0 + down * OPTICAL_TILT.1).unit(),
            r: RADIAL,
        }
    }

    /// Returns an ideal pinhole without the camera's distortion.
    pub fn pinhole(cam_from_site: &Pose, camera: &Camera) -> Self {
        let axis = |row: usize| cam_from_site.rotation.row(row).transpose();
        let (right, down, forward) = (axis(0), axis(1), axis(2));
        // Pixels of the camera begin at their corner, those of the lens at their centre.
        Self {
            c: cam_from_site.centre(),
            a: forward,
            h: right * camera.fx_px + forward * (camera.cx_px - 0.5),
            v: down * camera.fy_px + forward * (camera.cy_px - 0.5),
            o: forward,
            r: [0.0; 3],
        }
    }

    /// Returns the pixel of a point. `None` behind the camera.
    #[cfg(test)]
    pub fn project(&self, point: V3) -> Option<(f64, f64)> {
        let pixel = self.cahvor().project(&point)?;
        Some((pixel.x, pixel.y))
    }

    /// Returns the unit direction behind a pixel.
    pub fn ray(&self, x: f64, y: f64) -> V3 {
        let d = (self.v - self.a * y).cross(&(self.h - self.a * x));
        let d = if self.a.dot(&self.v.cross(&self.h)) < 0.0 {
            d * -1.0
        } else {
            d
        };
        let along = d.dot(&self.o);
        let off = d - self.o * along;
        let seen = off.norm() / along;
        if seen < 1e-12 {
            return self.o;
        }
        let mut true_tan = seen;
        for _ in 0..6 {
            let t2 = true_tan * true_tan;
            let value = true_tan * (1.0 + self.r[0] + t2 * (self.r[1] + t2 * self.r[2]));
            let slope = 1.0 + self.r[0] + t2 * (3.0 * self.r[1] + t2 * 5.0 * self.r[2]);
            let step = (value - seen) / slope;
            true_tan -= step;
            if step.abs() < 1e-9 {
                break; // Newton squares the error: the next step would be 1e-18.
            }
        }
        (self.o * along + off * (true_tan / seen)).unit()
    }

    /// Returns the camera moved by a rotation (columns) and then a shift.
    pub fn moved(&self, rotation: &[V3; 3], shift: V3) -> Self {
        let turn = |p: V3| rotate(rotation, p);
        Self {
            c: turn(self.c) + shift,
            a: turn(self.a),
            h: turn(self.h),
            v: turn(self.v),
            o: turn(self.o),
            r: self.r,
        }
    }

    /// Returns the camera of the photo reduced by boxes of `factor` x `factor` pixels.
    pub fn reduced(&self, factor: u32) -> Self {
        let (shift, scale) = ((f64::from(factor) - 1.0) / 2.0, 1.0 / f64::from(factor));
        Self {
            h: (self.h - self.a * shift) * scale,
            v: (self.v - self.a * shift) * scale,
            ..*self
        }
    }

    pub fn cahvor(&self) -> Cahvor {
        Cahvor {
            c: self.c.into(),
            a: self.a.into(),
            h: self.h.into(),
            v: self.v.into(),
            o: Some(self.o.into()),
            r: Some(self.r),
            e: None,
        }
    }
}

pub fn rotate(columns: &[V3; 3], p: V3) -> V3 {
    columns[0] * p.x + columns[1] * p.y + columns[2] * p.z
}

/// A pose of the rover: its attitude and its place in the site, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RoverPose {
    pub attitude: Quaternion,
    pub place: V3,
}

/// A unit quaternion.
pub type Quaternion = nalgebra::Quaternion<f64>;

/// Returns the rotation by an angle about a unit axis.
pub fn about(axis: V3, angle_rad: f64) -> Quaternion {
    let (sin, cos) = super::math::sin_cos(angle_rad / 2.0);
    Quaternion::from_parts(cos, axis * sin)
}

/// Returns the columns of the rotation matrix.
pub fn rotation_columns(turn: Quaternion) -> [V3; 3] {
    let (w, x, y, z) = (turn.w, turn.i, turn.j, turn.k);
    [
        v3(
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + w * z),
            2.0 * (x * z - w * y),
        ),
        v3(
            2.0 * (x * y - w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + w * x),
        ),
        v3(
            2.0 * (x * z + w * y),
            2.0 * (y * z - w * x),
            1.0 - 2.0 * (x * x + y * y),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_survives_its_ray() {
        let lens = Lens::new(
            v3(1.0, 2.0, -2.0),
            v3(0.8, 0.0, 0.6),
            v3(0.0, 1.0, 0.0),
            [640, 480],
            656.0,
        );
        for (x, y) in [(0.0, 0.0), (639.0, 479.0), (320.0, 240.0), (10.0, 470.0)] {
            let (u, v) = lens.project(lens.c + lens.ray(x, y) * 7.0).unwrap();
            assert!((u - x).abs() < 1e-10 && (v - y).abs() < 1e-10, "{x} {y}: {u} {v}");
        }
        assert_eq!(lens.project(lens.c - lens.a), None);
    }

    #[test]
    fn a_pinhole_sees_what_its_camera_sees() {
        let turn = rotation_columns(about(v3(0.6, 0.0, 0.8), 0.7));
        let cam_from_site = Pose {
            rotation: nalgebra::Matrix3::from_columns(&turn),
            translation: v3(0.3, -1.2, 2.0),
        };
        let camera = Camera {
            fy_px: 300.0,
            cx_px: 10.0,
            ..Camera::pinhole(64, 48, 200.0)
        };
        let lens = Lens::pinhole(&cam_from_site, &camera);
        let at = cam_from_site.centre() + cam_from_site.rotation.transpose() * v3(0.2, -0.1, 5.0);
        let (x, y) = lens.project(at).unwrap();
        // 10 + 200 * 0.2 / 5 and 24 + 300 * -0.1 / 5, less half a pixel.
        assert!((x - 17.5).abs() < 1e-12 && (y - 17.5).abs() < 1e-12, "{x} {y}");
    }

    /// Vectors computed with 50 digits elsewhere, for a Mastcam-Z-like model.
    #[test]
    fn projection_agrees_with_the_reference_vectors() {
        let lens = Lens {
            c: v3(0.8, 0.56, -1.92),
            a: v3(1.0, 0.0, 0.0),
            h: v3(823.5, 14800.0, 0.0),
            v: v3(599.5, 0.0, 14800.0),
            o: v3(1.0, 0.01, 0.01).unit(),
            r: [0.0002, 0.39, 0.035],
        };
        let (x, y) = lens.project(v3(5.8, 0.66, -1.82)).unwrap();
        assert!((x - 1_119.541_143_204_844).abs() < 1e-9, "{x}");
        assert!((y - 895.541_143_204_844).abs() < 1e-9, "{y}");
    }

    #[test]
    fn a_quaternion_turns_as_the_label_convention_says() {
        // Yaw +73.74 degrees: one metre ahead of a rover at (12.5, -3.25, 0.125) is (12.78, -2.29, 0.125).
        let q = Quaternion::new(0.8, 0.0, 0.0, 0.6);
        let ahead = rotate(&rotation_columns(q), v3(1.0, 0.0, 0.0)) + v3(12.5, -3.25, 0.125);
        assert!((ahead - v3(12.78, -2.29, 0.125)).norm() < 1e-12, "{ahead:?}");
    }
}
