//! Synthetic bundle adjustment problems with known ground truth, shared by unit tests and benches.

use marf_numeric::Rng;
use marf_scene::{Camera, Pose};
use marf_sfm::bundle::{CameraFreedom, LensModel, Observation, PoseFreedom, Problem};
use nalgebra::{Rotation3, Vector2, Vector3};

/// Size of a synthetic problem.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RingSize {
    pub poses: usize,
    pub points: usize,
    /// Consecutive photos that observe a point: 2 to this, mostly few.
    pub longest_track: usize,
    pub seed: u64,
}

/// Returns the exact problem: photos on a circle around a ball of points, pose 0 and one coordinate of pose 1 fixed.
pub(crate) fn ring(size: &RingSize) -> Problem {
    let mut rng = Rng::new(size.seed);
    let camera = Camera {
        k1: 0.094,
        k2: -0.131,
        ..Camera::pinhole(720, 960, 726.5)
    };
    let poses: Vec<Pose> = (0..size.poses)
        .map(|pose| pose_on_circle(pose as f64 / size.poses as f64, &mut rng))
        .collect();
    let mut problem = Problem {
        cameras: vec![camera],
        camera_freedom: vec![CameraFreedom {
            focal: true,
            lens: LensModel::Radial,
            principal_point: false,
        }],
        pose_freedom: vec![PoseFreedom::Free; size.poses],
        camera_of_pose: vec![0; size.poses],
        poses,
        ..Problem::default()
    };
    for _ in 0..size.points {
        add_point(&mut problem, size, &mut rng);
    }
    fix_gauge(&mut problem);
    problem
}

/// Fixes pose 0 and the coordinate in which pose 1 is farthest from it.
pub(crate) fn fix_gauge(problem: &mut Problem) {
    let baseline = problem.poses[1].centre() - problem.poses[0].centre();
    problem.pose_freedom[0] = PoseFreedom::Fixed;
    problem.pose_freedom[1] = PoseFreedom::CentreAxisFixed(baseline.iamax() as u8);
}

fn pose_on_circle(share: f64, rng: &mut Rng) -> Pose {
    let angle = share * std::f64::consts::TAU;
    let eye = Vector3::new(4.0 * libm::cos(angle), 4.0 * libm::sin(angle), 1.0) + vector(rng, 0.3);
    Pose::looking_at(eye, vector(rng, 0.2), -Vector3::z())
}

/// Adds a point that at least two consecutive photos observe.
fn add_point(problem: &mut Problem, size: &RingSize, rng: &mut Rng) {
    let point = vector(rng, 1.0);
    let index = problem.points.len() as u32;
    // The square makes short tracks frequent, as in real photos.
    let share = rng.unit_f64() * rng.unit_f64();
    let length = (2 + (share * (size.longest_track - 1) as f64) as usize).min(size.poses);
    let first = rng.below(size.poses as u64) as usize;
    let mut photos: Vec<usize> = (0..length).map(|step| (first + step) % size.poses).collect();
    photos.sort_unstable();
    for pose in photos {
        let seen = problem.poses[pose].point(&point);
        if let Some(pixel) = problem.cameras[0].project(&seen) {
            problem.observations.push(Observation {
                point: index,
                pose: pose as u32,
                pixel,
            });
        }
    }
    problem.points.push(point);
}

/// Returns a point uniform in a cube of side 2 `half`.
pub(crate) fn vector(rng: &mut Rng, half: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| (2.0 * rng.unit_f64() - 1.0) * half)
}

/// Returns a pair of normal numbers (Box and Muller).
pub(crate) fn normal_pair(rng: &mut Rng) -> Vector2<f64> {
    let radius = (-2.0 * libm::log(1.0 - rng.unit_f64())).sqrt();
    let angle = std::f64::consts::TAU * rng.unit_f64();
    Vector2::new(radius * libm::cos(angle), radius * libm::sin(angle))
}

/// Adds normal noise to all observations.
pub(crate) fn add_noise(problem: &mut Problem, sigma_px: f64, rng: &mut Rng) {
    for seen in &mut problem.observations {
        seen.pixel += normal_pair(rng) * sigma_px;
    }
}

/// Perturbs free parameters: rotations by `angle_rad`, centres and points by `distance`, each in a random direction.
pub(crate) fn perturb(problem: &mut Problem, angle_rad: f64, distance: f64, rng: &mut Rng) {
    for (pose, freedom) in problem.poses.iter_mut().zip(&problem.pose_freedom) {
        let mut offset = direction(rng) * distance;
        let turned = Rotation3::new(direction(rng) * angle_rad).into_inner() * pose.rotation;
        match freedom {
            PoseFreedom::Fixed => continue,
            PoseFreedom::CentreAxisFixed(axis) => offset[usize::from(*axis)] = 0.0,
            PoseFreedom::Free => {}
        }
        *pose = Pose {
            rotation: turned,
            translation: -(turned * (pose.centre() + offset)),
        };
    }
    for point in &mut problem.points {
        *point += direction(rng) * distance;
    }
}

fn direction(rng: &mut Rng) -> Vector3<f64> {
    let (a, b) = (normal_pair(rng), normal_pair(rng));
    Vector3::new(a.x, a.y, b.x).normalize()
}
