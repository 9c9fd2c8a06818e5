//! Synthetic views with known ground truth, for tests.

use marf_numeric::Rng;
use marf_scene::Pose;
use nalgebra::{Vector2, Vector3};

use super::epipolar::PointPair;
use super::rotation::exp_so3;

/// Returns the pose of a rotation vector and a translation.
pub(crate) fn pose(turn: [f64; 3], translation: [f64; 3]) -> Pose {
    Pose {
        rotation: exp_so3(&Vector3::from(turn)),
        translation: Vector3::from(translation),
    }
}

/// Returns a number of mean 0 and sigma 1: the sum of twelve uniform ones minus 6 (Irwin-Hall).
pub(crate) fn gauss(rng: &mut Rng) -> f64 {
    (0..12).map(|_| rng.unit_f64()).sum::<f64>() - 6.0
}

/// Adds normal noise to a position in the plane.
pub(crate) fn shaken(plane: Vector2<f64>, sigma: f64, rng: &mut Rng) -> Vector2<f64> {
    plane + Vector2::new(gauss(rng), gauss(rng)) * sigma
}

/// x / z, y / z.
pub(crate) fn plane_of(point: &Vector3<f64>) -> Vector2<f64> {
    point.xy() / point.z
}

/// Points in front of two cameras and where they are seen, plane units.
pub(crate) struct Scene {
    pub points: Vec<Vector3<f64>>,
    pub pairs: Vec<PointPair>,
}

impl Scene {
    /// `count` points in the frustum of camera 1 at depths 4 to 12, in front of camera 2 as well.
    pub(crate) fn new(seed: u64, count: usize, cam2_from_cam1: &Pose, sigma: f64) -> Self {
        let mut rng = Rng::new(seed);
        let points = std::iter::repeat_with(|| {
            let depth = 4.0 + 8.0 * rng.unit_f64();
            Vector3::new(
                (rng.unit_f64() - 0.5) * depth,
                (rng.unit_f64() - 0.5) * 1.3 * depth,
                depth,
            )
        });
        let seen = points.filter(|point| cam2_from_cam1.point(point).z > 0.5);
        Self::from_points(seen.take(count).collect(), cam2_from_cam1, sigma, seed)
    }

    pub(crate) fn from_points(
        points: Vec<Vector3<f64>>,
        cam2_from_cam1: &Pose,
        sigma: f64,
        seed: u64,
    ) -> Self {
        let mut rng = Rng::new(!seed);
        let pairs = points.iter().map(|point| {
            let planes = [plane_of(point), plane_of(&cam2_from_cam1.point(point))];
            planes.map(|plane| shaken(plane, sigma, &mut rng))
        });
        let pairs = pairs.collect();
        Self { points, pairs }
    }
}
