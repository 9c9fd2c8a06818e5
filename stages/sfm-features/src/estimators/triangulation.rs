//! Triangulation: points from the rays of several photos.

use marf_numeric::Rng;
use marf_scene::Pose;
use nalgebra::{Matrix3, SVector, Vector2, Vector3};

use super::levenberg_marquardt::{NormalEquations, minimise};
use super::rotation::ray_angle_rad;

/// The ray on which one photo observes a point.
#[derive(Debug, Clone)]
pub struct Ray {
    /// The pose of the photo.
    pub cam_from_world: Pose,
    /// Where it observes the point, in the plane z = 1 of the camera.
    pub plane: Vector2<f64>,
}

/// A triangulated point and the indices, rising, of its inliers.
#[derive(Debug, Clone)]
pub struct TriangulatedPoint {
    /// The point, in the world.
    pub point: Vector3<f64>,
    /// Indices of its inliers, rising.
    pub inliers: Vec<usize>,
}

/// Refinement steps: three suffice from a linear start, more only near the horizon.
const STEPS: usize = 10;

/// Below this sine two rays are parallel to rounding: their depth has no digit left.
const PARALLEL: f64 = 1e-9;

/// Largest number of hypotheses from two rays: all pairs of ten rays, else as many drawn. With half of the rays wrong all
/// 45 draws miss with probability 2e-6.
const HYPOTHESES: usize = 45;

/// Returns the point of least squared plane error over all rays, starting where the rays come closest.
///
/// `None` with fewer than two rays, with rays parallel to machine precision (every sine below 1e-9),
/// behind any camera, or not finite. The error grows as 1 / angle. Works in differences from the first
/// centre: the world's unit does not matter.
#[cfg(test)]
fn triangulate(rays: &[Ray]) -> Option<Vector3<f64>> {
    let all: Vec<&Ray> = rays.iter().collect();
    let start = nearest_to_rays(&all)?;
    refined(&start, &all).filter(|point| all.iter().all(|ray| depth(ray, point) > 0.0))
}

/// Returns the point with most inliers within `max_error` (plane units, one for each ray), refined on those.
///
/// Hypotheses come from pairs of rays: all of them up to ten rays, then 45 drawn with a fixed seed. An inlier is near
/// enough in the plane and has positive depth. The smallest truncated sum of squares wins, the first on ties. `None`
/// if there are fewer than two inliers, or no two of them have a triangulation angle of `min_angle_rad`.
pub fn triangulate_robust(rays: &[Ray], max_error: &[f64], min_angle_rad: f64) -> Option<TriangulatedPoint> {
    if rays.len() != max_error.len() {
        return None;
    }
    let errors2 = |point: &Vector3<f64>| {
        let pairs = rays.iter().zip(max_error);
        pairs
            .map(|(ray, limit)| offset2(ray, point) / (limit * limit))
            .collect::<Vec<f64>>()
    };
    let mut best: Option<(f64, Vector3<f64>, Vec<usize>)> = None;
    for (i, j) in hypotheses(rays.len()) {
        let pair = [&rays[i], &rays[j]];
        let Some(point) = nearest_to_rays(&pair) else {
            continue;
        };
        // Both rays must be inliers of their own point: two skew rays are not.
        let errors = errors2(&point);
        let cost: f64 = errors.iter().map(|error| error.min(1.0)).sum();
        if errors[i].max(errors[j]) <= 1.0 && best.as_ref().is_none_or(|(least, ..)| cost < *least) {
            best = Some((cost, point, agreed(&errors)));
        }
    }
    let (_, start, inliers) = best?;
    let chosen: Vec<&Ray> = inliers.iter().map(|&i| &rays[i]).collect();
    let refined = refined(&start, &chosen)?;
    let after = agreed(&errors2(&refined));
    // The refinement may lose inliers: then the start is kept.
    let (point, inliers) = if after.len() >= inliers.len() {
        (refined, after)
    } else {
        (start, inliers)
    };
    (inliers.len() >= 2 && wide_enough(rays, &inliers, &point, min_angle_rad))
        .then_some(TriangulatedPoint { point, inliers })
}

/// Returns the indices of errors within the limit.
fn agreed(errors2: &[f64]) -> Vec<usize> {
    (0..errors2.len()).filter(|&i| errors2[i] <= 1.0).collect()
}

/// Returns the pairs of rays to start from.
fn hypotheses(count: usize) -> Vec<(usize, usize)> {
    if count * count.saturating_sub(1) / 2 <= HYPOTHESES {
        return (0..count)
            .flat_map(|i| (i + 1..count).map(move |j| (i, j)))
            .collect();
    }
    let mut rng = Rng::new(count as u64);
    let drawn = (0..HYPOTHESES).map(|_| rng.sample::<2>(count));
    drawn.map(|[i, j]| (i.min(j), i.max(j))).collect()
}

/// Whether two inliers have at least this triangulation angle.
fn wide_enough(rays: &[Ray], inliers: &[usize], point: &Vector3<f64>, min_angle_rad: f64) -> bool {
    let centres: Vec<_> = inliers.iter().map(|&i| rays[i].cam_from_world.centre()).collect();
    let angle = |i: usize, j: usize| ray_angle_rad(&centres[i], &centres[j], point);
    (1..centres.len()).any(|j| (0..j).any(|i| angle(i, j) >= min_angle_rad))
}

/// Returns the point nearest to all rays in 3-D: the sum of (1 - d dᵀ)(X - C) is zero.
fn nearest_to_rays(rays: &[&Ray]) -> Option<Vector3<f64>> {
    let origin = rays.first()?.cam_from_world.centre();
    let direction_of = |ray: &Ray| (ray.cam_from_world.rotation.tr_mul(&ray.plane.push(1.0))).normalize();
    let first = direction_of(rays[0]);
    let mut size = 0.0_f64;
    let (mut across, mut target, mut sine) = (Matrix3::zeros(), Vector3::zeros(), 0.0_f64);
    for ray in rays {
        let (direction, offset) = (direction_of(ray), ray.cam_from_world.centre() - origin);
        let projector = Matrix3::identity() - direction * direction.transpose();
        across += projector;
        target += projector * offset;
        size = size.max(offset.amax());
        sine = sine.max(direction.cross(&first).norm());
    }
    if size.is_nan() || size == 0.0 || sine.is_nan() || sine < PARALLEL {
        return None;
    }
    let nearest = if let [one, two] = rays {
        midpoint(
            &first,
            &direction_of(two),
            &(two.cam_from_world.centre() - one.cam_from_world.centre()),
        )
    } else {
        across.cholesky()?.solve(&target)
    };
    let point = nearest + origin;
    point.iter().all(|value| value.is_finite()).then_some(point)
}

/// Returns the midpoint between the nearest points of two rays, the first from the origin. It uses cross products,
/// which keep the digits of small angles that 3 x 3 normal equations lose.
fn midpoint(first: &Vector3<f64>, second: &Vector3<f64>, centre: &Vector3<f64>) -> Vector3<f64> {
    let normal = first.cross(second);
    let area = normal.norm_squared();
    let (along_first, along_second) = (
        centre.cross(second).dot(&normal),
        centre.cross(first).dot(&normal),
    );
    (first * (along_first / area) + centre + second * (along_second / area)) * 0.5
}

/// Returns the point of least squared plane error near the start. No step may go behind a camera that saw the start.
fn refined(start: &Vector3<f64>, rays: &[&Ray]) -> Option<Vector3<f64>> {
    let linearise = |point: &Vector3<f64>| {
        let mut normal = NormalEquations::<3>::zero();
        for ray in rays {
            let local = ray.cam_from_world.point(point);
            if local.z <= 0.0 {
                return None;
            }
            let plane = local.xy() / local.z;
            let error = plane - ray.plane;
            for axis in 0..2 {
                let r = &ray.cam_from_world.rotation;
                let slope: SVector<f64, 3> = (r.row(axis) - r.row(2) * plane[axis]).transpose() / local.z;
                normal.add_weighed(error[axis], &slope, 1.0);
            }
            normal.cost += error.norm_squared();
        }
        Some(normal)
    };
    let point = minimise(start, STEPS, linearise, |point, step| point + step)?;
    point.iter().all(|value| value.is_finite()).then_some(point)
}

/// Returns the depth of a point in the frame of a camera.
#[cfg(test)]
fn depth(ray: &Ray, point: &Vector3<f64>) -> f64 {
    ray.cam_from_world.point(point).z
}

/// Returns the squared reprojection error in the plane. Infinite behind the camera.
fn offset2(ray: &Ray, point: &Vector3<f64>) -> f64 {
    let local = ray.cam_from_world.point(point);
    if local.z > 0.0 {
        (local.xy() / local.z - ray.plane).norm_squared()
    } else {
        f64::INFINITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::scenes::{plane_of, shaken};

    /// Cameras on a line, `step` apart, that look at a point `range` ahead of the first.
    fn rays(count: usize, step: f64, range: f64, sigma: f64, seed: u64) -> (Vector3<f64>, Vec<Ray>) {
        let (point, mut rng) = (Vector3::new(0.0, 0.0, range), Rng::new(seed));
        let rays = (0..count).map(|i| {
            let eye = Vector3::x() * (step * i as f64);
            let cam_from_world =
                Pose::looking_at(eye, point + Vector3::new(0.1, 0.2, 0.0) * range, Vector3::y());
            Ray {
                cam_from_world,
                plane: shaken(plane_of(&cam_from_world.point(&point)), sigma, &mut rng),
            }
        });
        (point, rays.collect())
    }

    #[test]
    fn the_error_grows_as_one_over_the_angle_and_is_never_nan() {
        let sigma = 1e-6;
        for angle_deg in [0.01, 0.1, 1.0, 10.0, 90.0_f64] {
            let step = libm::tan((angle_deg / 2.0).to_radians()) * 2.0;
            let mut total = 0.0;
            for seed in 0..50 {
                let (point, rays) = rays(2, step, 1.0, sigma, seed);
                total += (triangulate(&rays).unwrap() - point).norm() / 50.0;
            }
            let expected = sigma / angle_deg.to_radians().min(1.0);
            assert!(
                total < 4.0 * expected && total > expected / 4.0,
                "{angle_deg} deg: {total:e} {expected:e}"
            );
        }
    }

    #[test]
    fn exact_rays_meet_exactly_at_any_unit_and_tiny_baselines() {
        for (step, digits) in [(1.0, 1e-12), (1e-2, 1e-11), (1e-5, 1e-8)] {
            for unit in [1e-12, 1.0, 1e12] {
                for count in [2, 3, 7] {
                    let (point, rays) = rays(count, step * unit, unit, 0.0, 1);
                    let got = triangulate(&rays).unwrap();
                    let miss = (got - point).norm() / unit;
                    assert!(miss < digits, "step {step:e} unit {unit:e} of {count}: {miss:e}");
                }
            }
        }
    }

    #[test]
    fn an_origin_a_million_away_costs_the_digits_of_the_coordinates() {
        let (point, mut rays) = rays(3, 0.5, 3.0, 0.0, 1);
        let far = Vector3::new(1e6, -2e6, 5e5);
        for ray in &mut rays {
            let pose = &mut ray.cam_from_world;
            pose.translation -= pose.rotation * far;
        }
        let got = triangulate(&rays).unwrap();
        assert!(
            (got - far - point).norm() < 1e-8,
            "{:e}",
            (got - far - point).norm()
        );
    }

    #[test]
    fn parallel_backward_and_single_rays_are_refused() {
        let (_, mut pair) = rays(2, 0.5, 3.0, 0.0, 1);
        assert!(triangulate(&pair[..1]).is_none() && triangulate(&[]).is_none());
        assert!(
            triangulate(&[pair[0].clone(), pair[0].clone()]).is_none(),
            "zero baseline"
        );
        let ahead = Ray {
            cam_from_world: Pose::identity(),
            plane: Vector2::zeros(),
        };
        let beside = Pose {
            translation: -Vector3::x(),
            ..Pose::identity()
        };
        let infinite = [
            ahead.clone(),
            Ray {
                cam_from_world: beside,
                plane: Vector2::zeros(),
            },
        ];
        assert!(triangulate(&infinite).is_none(), "a point at infinity");
        let apart = [
            ahead,
            Ray {
                cam_from_world: beside,
                plane: Vector2::new(0.3, 0.0),
            },
        ];
        assert!(triangulate(&apart).is_none(), "rays meet behind");
        pair[0].plane.x = f64::NAN;
        assert!(triangulate(&pair).is_none(), "NaN");
        assert!(triangulate_robust(&pair, &[0.01; 2], 0.01).is_none(), "NaN");
    }

    #[test]
    fn wrong_sights_are_left_out_of_few_and_of_many() {
        for (count, wrong) in [(3, 1), (6, 3), (40, 20)] {
            let (point, mut all) = rays(count, 0.1, 2.0, 1e-4, 9);
            for (k, ray) in all.iter_mut().enumerate().take(wrong) {
                ray.plane += Vector2::new(0.05 + 0.01 * k as f64, 0.2 - 0.03 * k as f64);
            }
            let got = triangulate_robust(&all, &vec![1e-3; count], 0.01).unwrap();
            assert_eq!(
                got.inliers,
                (wrong..count).collect::<Vec<_>>(),
                "{wrong} of {count}"
            );
            assert!(
                (got.point - point).norm() < 5e-3,
                "{wrong} of {count}: {}",
                got.point
            );
        }
    }

    #[test]
    fn a_narrow_or_contradicting_set_of_sights_has_no_point() {
        let (_, narrow) = rays(4, 1e-3, 2.0, 0.0, 1);
        assert!(triangulate_robust(&narrow, &[1e-3; 4], 0.02).is_none(), "narrow");
        assert!(triangulate_robust(&narrow, &[1e-3; 4], 1e-4).is_some());
        assert!(
            triangulate_robust(&narrow, &[1e-3; 3], 1e-4).is_none(),
            "limits missing"
        );
        let (_, mut skew) = rays(2, 0.5, 2.0, 0.0, 1);
        skew[1].plane.y += 0.1;
        assert!(triangulate_robust(&skew, &[1e-3; 2], 0.01).is_none(), "skew");
    }
}
