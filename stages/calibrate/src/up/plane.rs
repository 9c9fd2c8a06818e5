//! The plane that most points of a scene are on, as cameras in front of it see it.

use marf_numeric::Rng;
use marf_scene::Point;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Points of a plane are this near to it, in their distances from the middle of the cameras.
const PLANE_NEAR: f64 = 0.03;
/// Share of points on a plane from which it counts.
const PLANE_SHARE: f64 = 0.35;
/// Planes through three points that are tried.
const PLANE_TRIALS: usize = 400;
/// Points that planes are tried on.
const PLANE_POINTS: usize = 2_000;

/// The plane that most points are on.
pub(super) struct Plane {
    /// Towards the cameras.
    pub normal: Vector3<f64>,
    /// Standard deviation of the normal: the relief of the points over their width.
    pub sigma_deg: f64,
    /// Median distance of the points from the middle of the cameras.
    pub distance: f64,
}

impl Plane {
    pub fn fit(centres: &[Vector3<f64>], points: &[Point]) -> Option<Self> {
        let step = points.len().div_ceil(PLANE_POINTS).max(1);
        let points: Vec<Vector3<f64>> = points
            .iter()
            .step_by(step)
            .map(|point| Vector3::from(point.position))
            .filter(|point| point.iter().all(|one| one.is_finite()))
            .collect();
        let middle = centres.iter().sum::<Vector3<f64>>() / centres.len() as f64;
        let distance = marf_numeric::upper_median(points.iter().map(|point| (point - middle).norm()))?;
        let first = Trial::best(&points, &middle)?;
        let on = points
            .iter()
            .filter(|point| first.height(point).abs() < PLANE_NEAR);
        let on: Vec<Vector3<f64>> = on.copied().collect();
        let count = on.len() as f64;
        if count < 10.0 || count < PLANE_SHARE * points.len() as f64 {
            return None;
        }
        let mean = on.iter().sum::<Vector3<f64>>() / count;
        let moves: Vec<Vector3<f64>> = on.iter().map(|point| point - mean).collect();
        let eigen = sorted(scatter(&moves, &vec![1.0; moves.len()]));
        let normal = eigen.direction[2];
        let above = |centre: &&Vector3<f64>| (*centre - mean).dot(&normal) > 0.0;
        let share = centres.iter().filter(above).count() as f64 / centres.len() as f64;
        let sign = match share {
            share if share > 0.9 => 1.0,
            share if share < 0.1 => -1.0,
            _ => return None,
        };
        let relief = (eigen.value[2].max(0.0) / eigen.value[1].max(f64::MIN_POSITIVE)).sqrt();
        Some(Self {
            normal: normal * sign,
            sigma_deg: relief.to_degrees(),
            distance,
        })
    }
}

/// A plane through three points.
struct Trial {
    point: Vector3<f64>,
    /// Towards the cameras, a unit vector.
    normal: Vector3<f64>,
    /// Middle of the cameras.
    middle: Vector3<f64>,
}

impl Trial {
    /// Returns the plane of the trials that has most points near it, less those behind it: nothing is seen through the ground. Without
    /// these, stones on the ground ahead tilt it by 5 degrees.
    fn best(points: &[Vector3<f64>], middle: &Vector3<f64>) -> Option<Self> {
        let mut rng = Rng::new(0);
        let mut best: Option<(i64, Self)> = None;
        for _ in 0..PLANE_TRIALS {
            let [a, b, c] = [(); 3].map(|()| points[rng.below(points.len() as u64) as usize]);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-12) else {
                continue;
            };
            let trial = Self {
                point: a,
                normal: normal * (middle - a).dot(&normal).signum(),
                middle: *middle,
            };
            let score = trial.score(points);
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, trial));
            }
        }
        best.map(|(_, trial)| trial)
    }

    fn score(&self, points: &[Vector3<f64>]) -> i64 {
        let heights = || points.iter().map(|point| self.height(point));
        let near = heights().filter(|height| height.abs() < PLANE_NEAR).count();
        near as i64 - heights().filter(|height| *height < -PLANE_NEAR).count() as i64
    }

    /// Returns the height of a point above the plane, in its distances from the middle of the cameras.
    fn height(&self, point: &Vector3<f64>) -> f64 {
        (point - self.point).dot(&self.normal) / (point - self.middle).norm()
    }
}

/// Eigenvalues and eigenvectors, largest first.
pub(super) struct Sorted {
    pub value: [f64; 3],
    pub direction: [Vector3<f64>; 3],
}

pub(super) fn sorted(matrix: Matrix3<f64>) -> Sorted {
    let eigen = SymmetricEigen::new(matrix);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    Sorted {
        value: order.map(|index| eigen.eigenvalues[index]),
        direction: order.map(|index| eigen.eigenvectors.column(index).into_owned()),
    }
}

/// Returns the weighted mean of v vᵀ.
pub(super) fn scatter(vectors: &[Vector3<f64>], weights: &[f64]) -> Matrix3<f64> {
    let sum: Matrix3<f64> = vectors
        .iter()
        .zip(weights)
        .map(|(one, weight)| one * one.transpose() * *weight)
        .sum();
    sum / weights.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}
