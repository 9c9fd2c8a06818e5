//! Synthetic pairs of photos with known ground truth.

use marf_numeric::Rng;
use marf_scene::{Camera, Pose};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::*;
use crate::estimators::scenes::{gauss, pose};
use crate::estimators::{log_so3, ray_angle_rad};

mod focal;
mod relative_pose;
mod verify;

const OPTIONS: VerifyOptions = VerifyOptions {
    max_error_px: 4.0,
    min_inliers: 15,
};

fn camera() -> Camera {
    Camera::pinhole(1000, 750, 900.0)
}

/// Features of two photos, the i-th of both the same point, and the motion between them.
struct Views {
    truth: Pose,
    a: Vec<Vector2<f64>>,
    b: Vec<Vector2<f64>>,
}

/// What the points of a made-up scene lie on.
#[derive(Debug, Clone, Copy)]
enum Layout {
    /// Depths 4 to 12.
    Deep,
    /// The plane z = 6 + 0.4 x - 0.3 y.
    Plane,
    /// The same, every tenth point up to 2 in front of it.
    AlmostPlane,
    /// One line.
    Line,
    /// A million times as far.
    Infinity,
}

fn depth(layout: Layout, index: usize, ray: &Vector3<f64>, rng: &mut Rng) -> f64 {
    let plane = 6.0 / (1.0 - 0.4 * ray.x + 0.3 * ray.y);
    match layout {
        Layout::Deep | Layout::Line => 4.0 + 8.0 * rng.unit_f64(),
        Layout::Plane => plane,
        Layout::AlmostPlane if index.is_multiple_of(10) => plane - 0.5 - 1.5 * rng.unit_f64(),
        Layout::AlmostPlane => plane,
        Layout::Infinity => 1e7 * (1.0 + rng.unit_f64()),
    }
}

/// `count` points seen in both photos, with Gaussian noise on both pixels.
fn views(truth: Pose, layout: Layout, count: usize, sigma_px: f64, seed: u64, camera: &Camera) -> Views {
    let mut rng = Rng::new(seed);
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for _ in 0..100_000 {
        let mut ray = Vector3::new((rng.unit_f64() - 0.5) * 1.1, (rng.unit_f64() - 0.5) * 0.8, 1.0);
        if let Layout::Line = layout {
            ray.y = 0.3 * ray.x + 0.1;
        }
        let point = ray * depth(layout, a.len(), &ray, &mut rng);
        if let (Some(p), Some(q)) = (camera.project(&point), camera.project(&truth.point(&point)))
            && q.x.abs() < 2000.0
            && a.len() < count
        {
            let mut noise = || Vector2::new(gauss(&mut rng), gauss(&mut rng)) * sigma_px;
            a.push(p + noise());
            b.push(q + noise());
        }
    }
    assert_eq!(a.len(), count);
    Views { truth, a, b }
}

impl Views {
    fn matches(&self) -> Vec<[u32; 2]> {
        (0..self.a.len() as u32).map(|i| [i, i]).collect()
    }

    /// Moves the first `wrong` features of photo 2 anywhere.
    fn with_outliers(mut self, wrong: usize, seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        for q in self.b.iter_mut().take(wrong) {
            *q = Vector2::new(rng.unit_f64() * 1000.0, rng.unit_f64() * 750.0);
        }
        self
    }

    fn verified(&self, camera: &Camera, focal: FocalKnown) -> VerifiedPair {
        let (a, b) = (
            ViewPoints {
                camera,
                pixels: &self.a,
            },
            ViewPoints {
                camera,
                pixels: &self.b,
            },
        );
        super::verify([&a, &b], &self.matches(), focal, &OPTIONS, 7)
    }

    fn relative_pose(&self, camera: &Camera) -> Option<RelativePose> {
        self.relative_pose_with(camera, FocalKnown::Known)
    }

    fn relative_pose_with(&self, camera: &Camera, focal: FocalKnown) -> Option<RelativePose> {
        let (a, b) = (
            ViewPoints {
                camera,
                pixels: &self.a,
            },
            ViewPoints {
                camera,
                pixels: &self.b,
            },
        );
        super::estimate_relative_pose([&a, &b], &self.matches(), focal, OPTIONS.max_error_px, 7)
    }

    /// Errors of rotation and of the direction of translation, degrees.
    fn errors_deg(&self, relation: &RelativePose) -> [f64; 2] {
        let turn = relation.cam2_from_cam1.rotation.transpose() * self.truth.rotation;
        let (got, truth) = (relation.cam2_from_cam1.translation, self.truth.translation);
        [
            log_so3(&turn).norm(),
            ray_angle_rad(&got, &truth, &Vector3::zeros()),
        ]
        .map(f64::to_degrees)
    }
}

fn sideways() -> Pose {
    pose([0.02, -0.12, 0.03], [1.0, 0.1, -0.1])
}
