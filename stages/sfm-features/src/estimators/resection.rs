//! Camera pose from 2D-3D correspondences (resection).

use marf_numeric::Rng;
use marf_scene::Pose;
use nalgebra::{SVector, Vector2, Vector3};

use super::levenberg_marquardt::{NormalEquations, minimise};
use super::p3p::p3p;
use super::ransac::RansacOptions;
use super::rotation::exp_so3;

/// A 2D-3D correspondence: a world point and its position in the image plane.
#[derive(Debug, Clone, Copy)]
pub struct PointObservation {
    /// Position in the plane z = 1 of the camera.
    pub plane: Vector2<f64>,
    /// The point, in the world.
    pub world: Vector3<f64>,
}

/// A camera pose and the indices, rising, of its inliers.
#[derive(Debug, Clone)]
pub struct Resection {
    /// The pose.
    pub cam_from_world: Pose,
    /// Indices of its inliers, rising.
    pub inliers: Vec<usize>,
}

/// Largest number of samples: finds a share of inliers of 0.12 with the confidence below. 500 observations cost 0.4
/// ms of CPU at a share of 0.7, 6 ms at 0.2, 40 ms without a pose.
const MAX_SAMPLES: u32 = 5000;
const CONFIDENCE: f64 = 0.9999;

/// Fewest inliers of a pose: three always fit, a fourth may by chance.
const MIN_INLIERS: usize = 6;

/// Damped steps inside the search, and at its end.
const QUICK_STEPS: usize = 4;
const LAST_STEPS: usize = 20;

/// Returns the pose with the largest consensus: LO-RANSAC over P3P, then a refinement on the inliers under Cauchy's loss.
///
/// `max_error` in plane units (pixels / focal). Equal observations count once. `None` with fewer than 6 inliers. The
/// caller's own minimum should be higher, since 6 of 500 may agree by chance.
pub fn resect(observations: &[PointObservation], max_error: f64, seed: u64) -> Option<Resection> {
    let usable = distinct(observations);
    let limit2 = max_error * max_error;
    let at = |i: usize| &observations[usable[i]];
    let options = RansacOptions {
        max_samples: MAX_SAMPLES,
        confidence: CONFIDENCE,
        min_inliers: MIN_INLIERS,
    };
    let solve = |sample: &[usize; 3]| p3p(&sample.map(|i| at(i).plane), &sample.map(|i| at(i).world));
    let error2 = |pose: &Pose, i: usize| offset2(pose, at(i)) / limit2;
    let scale = max_error / 2.0;
    let improve = |pose: &Pose, inliers: &[usize]| {
        let agreed = inliers.iter().map(|&i| at(i));
        (inliers.len() >= MIN_INLIERS)
            .then(|| refined(pose, agreed, scale, QUICK_STEPS))
            .flatten()
    };
    let found = options.lo_ransac(usable.len(), &mut Rng::new(seed), solve, error2, improve)?;
    if found.inliers.len() < MIN_INLIERS {
        return None;
    }
    let agreed = found.inliers.iter().map(|&i| at(i));
    let cam_from_world = refined(&found.model, agreed, scale, LAST_STEPS).unwrap_or(found.model);
    let inliers: Vec<usize> = usable
        .iter()
        .copied()
        .filter(|&i| offset2(&cam_from_world, &observations[i]) <= limit2)
        .collect();
    (inliers.len() >= MIN_INLIERS && cam_from_world.is_valid()).then_some(Resection {
        cam_from_world,
        inliers,
    })
}

/// Returns the pose refined on observations. It rotates about the camera centre and moves along the camera's axes, so
/// that a distant origin costs no more digits than t has lost.
fn refined<'a>(
    start: &Pose,
    observations: impl Iterator<Item = &'a PointObservation> + Clone,
    scale: f64,
    steps: usize,
) -> Option<Pose> {
    let in_front = observations
        .clone()
        .filter(|observation| start.point(&observation.world).z > 0.0)
        .count();
    if in_front < 3 {
        return None;
    }
    let linearise = |pose: &Pose| {
        let mut normal = NormalEquations::<6>::zero();
        for observation in observations.clone() {
            let point = pose.point(&observation.world);
            if point.z > 0.0 {
                add_offset(&mut normal, &point, &observation.plane, scale * scale);
            } else {
                // An observation behind the camera costs as much as an error of 1 in the plane.
                normal.cost += scale * scale * libm::log1p(1.0 / (scale * scale));
            }
        }
        normal.cost.is_finite().then_some(normal)
    };
    let moved = |pose: &Pose, step: &SVector<f64, 6>| {
        let rotation = exp_so3(&step.fixed_rows::<3>(0).into_owned());
        Pose {
            rotation: rotation * pose.rotation,
            translation: rotation * pose.translation + step.fixed_rows::<3>(3),
        }
    };
    let pose = minimise(start, steps, linearise, moved)?;
    pose.is_valid().then_some(pose)
}

/// Adds both coordinates of x / z - u under one Cauchy weight, with derivatives by rotation and translation of the camera
/// frame.
fn add_offset(normal: &mut NormalEquations<6>, point: &Vector3<f64>, plane: &Vector2<f64>, scale2: f64) {
    let inverse = 1.0 / point.z;
    let (x, y) = (point.x * inverse, point.y * inverse);
    let (dx, dy) = (x - plane.x, y - plane.y);
    let squared = (dx * dx + dy * dy) / scale2;
    let weight = 1.0 / (1.0 + squared);
    normal.cost += scale2 * libm::log1p(squared);
    normal.add_weighed(
        dx,
        &[-x * y, 1.0 + x * x, -y, inverse, 0.0, -x * inverse].into(),
        weight,
    );
    normal.add_weighed(
        dy,
        &[-1.0 - y * y, x * y, x, 0.0, inverse, -y * inverse].into(),
        weight,
    );
}

/// Returns the squared reprojection error in the plane. Infinite behind the camera.
fn offset2(pose: &Pose, observation: &PointObservation) -> f64 {
    let point = pose.point(&observation.world);
    if point.z > 0.0 {
        let inverse = 1.0 / point.z;
        let (dx, dy) = (
            point.x * inverse - observation.plane.x,
            point.y * inverse - observation.plane.y,
        );
        dx * dx + dy * dy
    } else {
        f64::INFINITY
    }
}

/// Returns the index of the first of each group of equal finite observations, rising.
fn distinct(observations: &[PointObservation]) -> Vec<usize> {
    let bits = |i: usize| {
        let PointObservation { plane, world } = &observations[i];
        [plane.x, plane.y, world.x, world.y, world.z].map(f64::to_bits)
    };
    let finite = |i: &usize| {
        let PointObservation { plane, world } = &observations[*i];
        plane.iter().chain(world.iter()).all(|value| value.is_finite())
    };
    let mut order: Vec<usize> = (0..observations.len()).filter(finite).collect();
    order.sort_by_key(|&i| (bits(i), i));
    order.dedup_by_key(|i| bits(*i));
    order.sort_unstable();
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::scenes::{Scene, plane_of, pose, shaken};

    const MAX_ERROR: f64 = 4.0 / 700.0;

    /// 200 observations, the first `good` of them true within `sigma`, in a world scaled and moved.
    fn observations(good: usize, sigma: f64, scale: f64, origin: f64) -> (Pose, Vec<PointObservation>) {
        let mut truth = pose([0.3, -0.2, 0.9], [0.2, 0.5, -0.3]);
        truth.translation *= scale;
        let back = truth.inverse();
        let offset = Vector3::new(origin, -origin, 0.5 * origin);
        let mut rng = Rng::new(11);
        let points = Scene::new(4, 200, &Pose::identity(), 0.0).points;
        let seen = points.iter().enumerate().map(|(i, point)| {
            let random = Vector2::new(rng.unit_f64() - 0.5, rng.unit_f64() - 0.5);
            let plane = if i < good {
                shaken(plane_of(point), sigma, &mut rng)
            } else {
                random
            };
            PointObservation {
                plane,
                world: back.point(&(point * scale)) + offset,
            }
        });
        let seen = seen.collect();
        truth.translation -= truth.rotation * offset;
        (truth, seen)
    }

    #[test]
    fn poses_survive_outliers_up_to_nine_in_ten_and_noise_is_not_found_in_noise() {
        for (good, least) in [(200, 200), (100, 100), (20, 20), (10, 0), (0, 0)] {
            let (truth, seen) = observations(good, 0.0, 1.0, 0.0);
            let found = resect(&seen, MAX_ERROR, 1);
            let agreed = found.as_ref().map_or(0, |found| found.inliers.len());
            assert!(agreed >= least, "{good} of 200: {agreed}");
            if let Some(found) = found.filter(|_| good >= 20) {
                let miss = (found.cam_from_world.centre() - truth.centre()).norm();
                assert!(miss < 1e-2, "{good} of 200: {miss:e}");
            }
            // Chance alone: below the 12 to 15 a mapper asks for.
            assert!(good >= 20 || agreed < 12, "{good} of 200: {agreed}");
        }
    }

    #[test]
    fn the_error_follows_the_noise() {
        for sigma_px in [0.0, 0.1, 1.0, 5.0] {
            let (truth, seen) = observations(200, sigma_px / 700.0, 1.0, 0.0);
            let found = resect(&seen, 3.0 * MAX_ERROR, 2).unwrap();
            let miss = (found.cam_from_world.centre() - truth.centre()).norm();
            // Depth 8, 200 points: 8 / 700 * 3 / sqrt(200) a pixel, thrice for luck.
            assert!(miss < 0.01 * sigma_px + 1e-9, "{sigma_px} px: {miss:e}");
        }
    }

    #[test]
    fn unit_and_origin_of_the_world_do_not_matter() {
        for (scale, origin, digits) in [(1e-12, 0.0, 1e-9), (1e12, 0.0, 1e-9), (1.0, 1e6, 1e-7)] {
            let (truth, seen) = observations(150, 0.0, scale, origin);
            let found = resect(&seen, MAX_ERROR, 3).unwrap();
            let miss = (found.cam_from_world.centre() - truth.centre()).norm() / scale;
            assert!(
                miss < digits && found.inliers.len() >= 150,
                "{scale:e} {origin:e}: {miss:e}"
            );
        }
    }

    #[test]
    fn a_planar_world_has_one_pose() {
        let truth = Pose::looking_at(Vector3::new(1.0, 2.0, -4.0), Vector3::zeros(), Vector3::y());
        let seen: Vec<PointObservation> = (0..40)
            .map(|i| Vector3::new(f64::from(i % 8) * 0.3 - 1.0, f64::from(i / 8) * 0.4 - 1.0, 0.0))
            .map(|world| PointObservation {
                plane: plane_of(&truth.point(&world)),
                world,
            })
            .collect();
        let found = resect(&seen, MAX_ERROR, 4).unwrap();
        assert!((found.cam_from_world.centre() - truth.centre()).norm() < 1e-9);
    }

    #[test]
    fn repeated_few_collinear_or_broken_observations_are_refused() {
        let (_, seen) = observations(200, 0.0, 1.0, 0.0);
        let repeated: Vec<PointObservation> = (0..100).map(|i| seen[i % 5]).collect();
        assert!(
            resect(&repeated, MAX_ERROR, 5).is_none(),
            "five points a hundred times"
        );
        assert!(resect(&seen[..2], MAX_ERROR, 5).is_none() && resect(&[], MAX_ERROR, 5).is_none());
        let line: Vec<PointObservation> = (1..50)
            .map(|i| Vector3::new(0.1, 0.1, 1.0) * f64::from(i) + Vector3::x())
            .map(|world| PointObservation {
                plane: plane_of(&world),
                world,
            })
            .collect();
        assert!(resect(&line, MAX_ERROR, 5).is_none(), "collinear");
        let broken: Vec<PointObservation> = seen
            .iter()
            .map(|s| PointObservation {
                world: s.world * f64::INFINITY,
                ..*s
            })
            .collect();
        assert!(resect(&broken, MAX_ERROR, 5).is_none(), "infinite");
    }

    #[test]
    fn slopes_agree_with_central_differences() {
        let (point, plane) = (Vector3::new(0.4, -0.7, 3.0), Vector2::new(0.1, -0.2));
        let cost_and_slope = |step: &SVector<f64, 6>| {
            let turned = exp_so3(&step.fixed_rows::<3>(0).into_owned()) * point + step.fixed_rows::<3>(3);
            let mut normal = NormalEquations::<6>::zero();
            add_offset(&mut normal, &turned, &plane, 0.01);
            normal
        };
        let gradient = cost_and_slope(&SVector::zeros()).gradient;
        for k in 0..6 {
            let at = |h: f64| {
                let mut step = SVector::zeros();
                step[k] = h;
                cost_and_slope(&step).cost
            };
            let central = (at(1e-6) - at(-1e-6)) / 4e-6;
            assert!(
                (central - gradient[k]).abs() < 1e-8,
                "{k}: {central} {}",
                gradient[k]
            );
        }
    }

    #[test]
    fn polish_needs_three_points_in_front() {
        let (truth, seen) = observations(200, 0.0, 1.0, 0.0);
        let polish = |start: &Pose, seen: &[PointObservation]| refined(start, seen.iter(), 0.01, LAST_STEPS);
        assert!(polish(&truth, &seen[..2]).is_none());
        let mut behind = truth;
        behind.translation.z -= 100.0;
        assert!(polish(&behind, &seen).is_none());
        let near = pose([0.01, -0.02, 0.01], [0.05, 0.0, 0.1]) * truth;
        let got = polish(&near, &seen).unwrap();
        assert!((got.translation - truth.translation).norm() < 1e-9);
    }
}
