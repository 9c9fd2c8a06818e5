//! The similarity between two worlds from points that are known in both.

use marf_numeric::Rng;
use marf_scene::{Camera, Pose};
use marf_sfm_features::estimators::{RansacOptions, nearest_rotation};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::similarity::Similarity;

/// A point of a world, and where a photo of that world shows it.
#[derive(Debug, Clone, Copy)]
pub struct Sighting<'a> {
    /// Position in the world.
    pub point: Vector3<f64>,
    /// The photo's pose.
    pub cam_from_world: &'a Pose,
    /// Its camera.
    pub camera: &'a Camera,
    /// Where it shows the point, pixels.
    pub pixel: Vector2<f64>,
    /// Largest error of an inlier, pixels.
    pub max_error_px: f64,
}

/// A similarity with the points that agree with it.
#[derive(Debug, Clone)]
pub struct PointAlignment {
    /// The first world from the second.
    pub similarity: Similarity,
    /// Indices of the inliers, rising.
    pub inliers: Vec<usize>,
}

/// Samples of three points. At 30 % of inliers 160 would do.
const SAMPLES: u32 = 4_000;

impl Sighting<'_> {
    /// Returns the squared distance between the projection of a position in this world and the observed point, in
    /// units of the largest error. Infinite behind the camera.
    fn error2(&self, point: &Vector3<f64>) -> f64 {
        let seen = self.camera.project(&self.cam_from_world.point(point));
        seen.map_or(f64::INFINITY, |seen| {
            (seen - self.pixel).norm_squared() / (self.max_error_px * self.max_error_px)
        })
    }

    /// Returns 1 / z², which makes equal errors across the line of sight of equal weight as the camera sees them.
    fn weight(&self) -> f64 {
        let z = self.cam_from_world.point(&self.point).z;
        1.0 / (z * z)
    }
}

/// Returns the similarity of two worlds that most pairs of one point agree with: each, moved into the world of the other, lies where the
/// other's photo shows it. `None` with fewer than three pairs, or if fewer than `min_inliers` agree.
///
/// Least squares of Umeyama (1991) over inliers, weighed by distance, in LO-RANSAC.
pub fn align_points(pairs: &[[Sighting<'_>; 2]], min_inliers: usize, seed: u64) -> Option<PointAlignment> {
    let options = RansacOptions {
        max_samples: SAMPLES,
        confidence: 0.999_9,
        min_inliers,
    };
    let error2 = |similarity: &Similarity, index: usize| {
        let [a, b] = &pairs[index];
        let in_b = similarity.inverse().point(&a.point);
        a.error2(&similarity.point(&b.point)).max(b.error2(&in_b))
    };
    let solve = |sample: &[usize; 3]| fit(pairs, sample).into_iter().collect();
    let improve = |_: &Similarity, inliers: &[usize]| fit(pairs, inliers);
    let found = options.lo_ransac(pairs.len(), &mut Rng::new(seed), solve, error2, improve)?;
    (found.inliers.len() >= min_inliers.max(3)).then_some(PointAlignment {
        similarity: found.model,
        inliers: found.inliers,
    })
}

/// Returns the least-squares similarity over some pairs. `None` if they do not determine the scale.
fn fit(pairs: &[[Sighting<'_>; 2]], chosen: &[usize]) -> Option<Similarity> {
    let chosen = || {
        chosen
            .iter()
            .map(|&index| (&pairs[index], pairs[index][0].weight()))
    };
    let total: f64 = chosen().map(|(_, weight)| weight).sum();
    let mean = |side: usize| {
        let points = chosen().map(|(pair, weight)| pair[side].point * weight);
        points.sum::<Vector3<f64>>() / total
    };
    let middle = [mean(0), mean(1)];
    let centred = |pair: &[Sighting<'_>; 2]| [pair[0].point - middle[0], pair[1].point - middle[1]];
    let products = chosen().map(|(pair, weight)| {
        let [a, b] = centred(pair);
        a * b.transpose() * weight
    });
    let rotation = nearest_rotation(&products.sum::<Matrix3<f64>>());
    let (mut along, mut squared) = (0.0, 0.0);
    for (pair, weight) in chosen() {
        let [a, b] = centred(pair);
        along += weight * a.dot(&(rotation * b));
        squared += weight * b.norm_squared();
    }
    let scale = along / squared;
    (scale.is_finite() && scale > 0.0).then(|| Similarity {
        scale,
        rotation,
        translation: middle[0] - scale * (rotation * middle[1]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> Similarity {
        Similarity {
            scale: 2.5,
            rotation: Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0),
            translation: Vector3::new(40.0, -7.0, 3.0),
        }
    }

    /// Points 5 to 30 away from two cameras, known in the world of each. Every third is of another place.
    fn aligned(count: usize, wrong_every: usize, min_inliers: usize) -> Option<PointAlignment> {
        let camera = Camera::pinhole(640, 480, 500.0);
        let eye = |x: f64| {
            Pose::looking_at(
                Vector3::new(x, 0.0, 0.0),
                Vector3::new(0.0, 0.0, 15.0),
                Vector3::y(),
            )
        };
        let (pose_b, other) = (eye(-1.0), eye(1.5));
        let pose_a = truth().pose(&other);
        let mut rng = Rng::new(3);
        let mut random = |low: f64, high: f64| low + (high - low) * rng.unit_f64();
        let pairs: Vec<[Sighting<'_>; 2]> = (0..count)
            .map(|index| {
                let z = random(5.0, 30.0);
                let in_b = Vector3::new(random(-0.3, 0.3) * z, random(-0.3, 0.3) * z, z);
                let mut in_a = truth().point(&in_b);
                if wrong_every > 0 && index % wrong_every == 0 {
                    in_a += Vector3::new(random(1.0, 9.0), random(1.0, 9.0), random(1.0, 9.0));
                }
                let sighting = |point: Vector3<f64>, pose| {
                    let cam_from_world: &Pose = pose;
                    Some(Sighting {
                        point,
                        cam_from_world,
                        camera: &camera,
                        pixel: camera.project(&cam_from_world.point(&point))?,
                        max_error_px: 2.0,
                    })
                };
                [sighting(in_a, &pose_a).unwrap(), sighting(in_b, &pose_b).unwrap()]
            })
            .collect();
        align_points(&pairs, min_inliers, 1)
    }

    #[test]
    fn the_similarity_is_found_among_points_of_other_places() {
        let found = aligned(60, 3, 20).unwrap();
        assert_eq!(found.inliers.len(), 40);
        assert!(found.inliers.iter().all(|index| index % 3 != 0));
        let (similarity, truth) = (found.similarity, truth());
        assert!((similarity.scale - truth.scale).abs() < 1e-9);
        assert!((similarity.rotation - truth.rotation).norm() < 1e-9);
        assert!((similarity.translation - truth.translation).norm() < 1e-7);
        let there_and_back = similarity
            .inverse()
            .point(&similarity.point(&Vector3::new(1.0, 2.0, 3.0)));
        assert!((there_and_back - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    }

    #[test]
    fn too_few_points_or_none_that_agree_give_no_answer() {
        assert!(aligned(2, 0, 2).is_none());
        assert!(aligned(0, 0, 0).is_none());
        assert!(aligned(60, 1, 20).is_none(), "all are of other places");
        assert!(aligned(19, 0, 20).is_none());
        assert!(aligned(3, 0, 3).is_some());
    }
}
