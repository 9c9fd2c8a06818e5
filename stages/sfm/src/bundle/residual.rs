//! The reprojection error of one observation and its derivatives by pose, point and camera.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Parameters of a camera, in this order: ln f, k1, k2, p1, p2, cx, cy.
pub(super) const CAMERA_PARAMS: usize = 7;

/// A parameter of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CameraParam {
    /// Logarithm of fx. fy keeps its ratio.
    Focal,
    K1,
    K2,
    P1,
    P2,
    Cx,
    Cy,
}

/// A pose by rotation and camera centre: x_cam = R (X - C).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CentredPose {
    /// R of `cam_from_world`.
    pub rotation: Matrix3<f64>,
    /// C, in the world.
    pub centre: Vector3<f64>,
}

/// A point in the frame of a camera and its ideal projection, before distortion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Projection {
    in_camera: Vector3<f64>,
    inverse_depth: f64,
    x: f64,
    y: f64,
    r2: f64,
}

/// Residual of one observation and its derivatives, all multiplied by the square root of its weight.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ResidualBlock {
    pub error: [f64; 2],
    /// By the left-multiplied rotation of the camera, radian.
    pub rotation: [[f64; 3]; 2],
    /// By the point. The derivative by the camera centre is the negative.
    pub point: [[f64; 3]; 2],
}

/// Derivatives of a residual by the free parameters of its camera. The rest is zero.
pub(super) type CameraJacobian = [[f64; CAMERA_PARAMS]; 2];

/// Returns the projection of a point. `None` behind the camera or beyond the fold of the distortion.
#[inline]
pub(super) fn project(view: &CentredPose, camera: &Camera, point: &Vector3<f64>) -> Option<Projection> {
    let in_camera = view.rotation * (point - view.centre);
    if in_camera.z.is_nan() || in_camera.z <= 0.0 {
        return None;
    }
    let inverse_depth = 1.0 / in_camera.z;
    let (x, y) = (in_camera.x * inverse_depth, in_camera.y * inverse_depth);
    let r2 = x * x + y * y;
    unfolded(camera, r2).then_some(Projection {
        in_camera,
        inverse_depth,
        x,
        y,
        r2,
    })
}

/// Whether r (1 + k1 r² + k2 r⁴) rises from 0 to r, as `Camera::project` tests. False if not finite.
#[inline]
fn unfolded(camera: &Camera, r2: f64) -> bool {
    let (k1, k2) = (camera.k1, camera.k2);
    let rises = |r2: f64| 1.0 + r2 * (3.0 * k1 + r2 * 5.0 * k2) > 0.0;
    rises(r2) && (k1 >= 0.0 || k2 <= 0.0 || rises((-0.3 * k1 / k2).min(r2)))
}

impl Projection {
    /// Returns the distorted position in the image plane.
    #[inline]
    fn distorted(&self, camera: &Camera) -> (f64, f64) {
        let Self { x, y, r2, .. } = *self;
        let radial = 1.0 + r2 * (camera.k1 + r2 * camera.k2);
        let twice = 2.0 * x * y;
        (
            x * radial + camera.p1 * twice + camera.p2 * (r2 + 2.0 * x * x),
            y * radial + camera.p1 * (r2 + 2.0 * y * y) + camera.p2 * twice,
        )
    }

    /// Returns projected minus observed, pixels.
    #[inline]
    pub(super) fn error(&self, camera: &Camera, pixel: &Vector2<f64>) -> [f64; 2] {
        let (x, y) = self.distorted(camera);
        [
            camera.fx_px * x + camera.cx_px - pixel.x,
            camera.fy_px * y + camera.cy_px - pixel.y,
        ]
    }

    /// Returns the derivatives of `error`, times `weight`.
    #[inline]
    pub(super) fn row(
        &self,
        view: &CentredPose,
        camera: &Camera,
        error: [f64; 2],
        weight: f64,
    ) -> ResidualBlock {
        let [first, second] = self.by_point_in_camera(camera, weight);
        let by_point = |a: &Vector3<f64>| (view.rotation.tr_mul(a)).into();
        // a . (rotation x point) = rotation . (point x a)
        let by_rotation = |a: &Vector3<f64>| self.in_camera.cross(a).into();
        ResidualBlock {
            error: [error[0] * weight, error[1] * weight],
            rotation: [by_rotation(&first), by_rotation(&second)],
            point: [by_point(&first), by_point(&second)],
        }
    }

    /// Returns d pixel / d point in the frame of the camera, two rows, times `weight`.
    #[inline]
    fn by_point_in_camera(&self, camera: &Camera, weight: f64) -> [Vector3<f64>; 2] {
        let Self { x, y, r2, .. } = *self;
        let Camera { k1, k2, p1, p2, .. } = *camera;
        let radial = 1.0 + r2 * (k1 + r2 * k2);
        let slope = 2.0 * (k1 + 2.0 * k2 * r2);
        let xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x;
        let xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        let yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x;
        let scale = self.inverse_depth * weight;
        [
            Vector3::new(xx, xy, -(xx * x + xy * y)) * (camera.fx_px * scale),
            Vector3::new(xy, yy, -(xy * x + yy * y)) * (camera.fy_px * scale),
        ]
    }

    /// Returns d pixel / d parameter for each of `terms`, times `weight`.
    #[inline]
    pub(super) fn camera_jacobian(
        &self,
        camera: &Camera,
        terms: &[CameraParam],
        weight: f64,
    ) -> CameraJacobian {
        let Self { x, y, r2, .. } = *self;
        let (fx, fy) = (camera.fx_px * weight, camera.fy_px * weight);
        let mut row = CameraJacobian::default();
        for (column, term) in terms.iter().enumerate().take(CAMERA_PARAMS) {
            let (by_x, by_y) = match term {
                CameraParam::Focal => self.distorted(camera),
                CameraParam::K1 => (x * r2, y * r2),
                CameraParam::K2 => (x * r2 * r2, y * r2 * r2),
                CameraParam::P1 => (2.0 * x * y, r2 + 2.0 * y * y),
                CameraParam::P2 => (r2 + 2.0 * x * x, 2.0 * x * y),
                CameraParam::Cx => (1.0 / camera.fx_px, 0.0),
                CameraParam::Cy => (0.0, 1.0 / camera.fy_px),
            };
            row[0][column] = fx * by_x;
            row[1][column] = fy * by_y;
        }
        row
    }
}
