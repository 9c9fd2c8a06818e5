//! One observation: its residual in pixels and how that changes with pose, point and lens.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Numbers of a lens that may move, in this order: ln f, k1, k2, p1, p2, cx, cy.
pub(super) const LENS_TERMS: usize = 7;

/// A number of a camera that may move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Term {
    /// Logarithm of fx; fy keeps its ratio.
    Focal,
    K1,
    K2,
    P1,
    P2,
    Cx,
    Cy,
}

/// Where a photo was taken from: x_cam = R (X - C).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct View {
    /// R of `cam_from_world`.
    pub rotation: Matrix3<f64>,
    /// C, in the world.
    pub centre: Vector3<f64>,
}

/// A point as a camera sees it, before the lens.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    seen: Vector3<f64>,
    inverse_depth: f64,
    x: f64,
    y: f64,
    r2: f64,
}

/// Residual of one observation and its derivatives, all times the root of its weight.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Row {
    pub error: [f64; 2],
    /// By the left-multiplied turn of the camera, radian.
    pub turn: [[f64; 3]; 2],
    /// By the point; by the camera's centre it is the negative.
    pub point: [[f64; 3]; 2],
}

/// Derivatives of a residual by the terms of its lens that may move; the rest is zero.
pub(super) type LensRow = [[f64; LENS_TERMS]; 2];

/// Returns the point in the camera's frame; `None` behind the camera or beyond the lens's fold.
#[inline]
pub(super) fn sight(view: &View, camera: &Camera, point: &Vector3<f64>) -> Option<Sight> {
    let seen = view.rotation * (point - view.centre);
    if seen.z.is_nan() || seen.z <= 0.0 {
        return None;
    }
    let inverse_depth = 1.0 / seen.z;
    let (x, y) = (seen.x * inverse_depth, seen.y * inverse_depth);
    let r2 = x * x + y * y;
    unfolded(camera, r2).then_some(Sight {
        seen,
        inverse_depth,
        x,
        y,
        r2,
    })
}

/// The test of `Camera::project`: r (1 + k1 r² + k2 r⁴) rises from 0 to r. False for what is not finite.
#[inline]
fn unfolded(camera: &Camera, r2: f64) -> bool {
    let (k1, k2) = (camera.k1, camera.k2);
    let rises = |r2: f64| 1.0 + r2 * (3.0 * k1 + r2 * 5.0 * k2) > 0.0;
    rises(r2) && (k1 >= 0.0 || k2 <= 0.0 || rises((-0.3 * k1 / k2).min(r2)))
}

impl Sight {
    /// Returns the distorted point of the image plane.
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
    pub(super) fn row(&self, view: &View, camera: &Camera, error: [f64; 2], weight: f64) -> Row {
        let [first, second] = self.by_seen(camera, weight);
        let by_point = |a: &Vector3<f64>| (view.rotation.tr_mul(a)).into();
        // a . (turn x seen) = turn . (seen x a)
        let by_turn = |a: &Vector3<f64>| self.seen.cross(a).into();
        Row {
            error: [error[0] * weight, error[1] * weight],
            turn: [by_turn(&first), by_turn(&second)],
            point: [by_point(&first), by_point(&second)],
        }
    }

    /// Returns d pixel / d point in the camera's frame, two rows, times `weight`.
    #[inline]
    fn by_seen(&self, camera: &Camera, weight: f64) -> [Vector3<f64>; 2] {
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

    /// Returns d pixel / d term for each of `terms`, times `weight`.
    #[inline]
    pub(super) fn lens_row(&self, camera: &Camera, terms: &[Term], weight: f64) -> LensRow {
        let Self { x, y, r2, .. } = *self;
        let (fx, fy) = (camera.fx_px * weight, camera.fy_px * weight);
        let mut row = LensRow::default();
        for (column, term) in terms.iter().enumerate().take(LENS_TERMS) {
            let (by_x, by_y) = match term {
                Term::Focal => self.distorted(camera),
                Term::K1 => (x * r2, y * r2),
                Term::K2 => (x * r2 * r2, y * r2 * r2),
                Term::P1 => (2.0 * x * y, r2 + 2.0 * y * y),
                Term::P2 => (r2 + 2.0 * x * x, 2.0 * x * y),
                Term::Cx => (1.0 / camera.fx_px, 0.0),
                Term::Cy => (0.0, 1.0 / camera.fy_px),
            };
            row[0][column] = fx * by_x;
            row[1][column] = fy * by_y;
        }
        row
    }
}
