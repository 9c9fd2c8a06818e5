//! A made-up walk around a heap of points whose truth is known, for tests and benches.

use marf_scene::{Camera, Pose};
use nalgebra::{Vector2, Vector3};

use super::{CameraFreedom, LensModel, Observation, PoseFreedom, Problem, turn};
use crate::dice::Dice;

/// How large a scene is made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Walk {
    pub poses: usize,
    pub points: usize,
    /// Photos in a row that see a point: 2 to this, most of them few.
    pub longest_track: usize,
    pub seed: u64,
}

/// Returns the exact problem: photos on a circle around a ball of points, pose 0 and one axis of pose 1 held.
pub(crate) fn walk(walk: &Walk) -> Problem {
    let mut dice = Dice::new(walk.seed);
    let camera = Camera {
        k1: 0.094,
        k2: -0.131,
        ..Camera::pinhole(720, 960, 726.5)
    };
    let poses: Vec<Pose> = (0..walk.poses)
        .map(|pose| pose_on_circle(pose as f64 / walk.poses as f64, &mut dice))
        .collect();
    let mut problem = Problem {
        cameras: vec![camera],
        camera_freedom: vec![CameraFreedom {
            focal: true,
            lens: LensModel::Radial,
            principal_point: false,
        }],
        pose_freedom: vec![PoseFreedom::Free; walk.poses],
        camera_of_pose: vec![0; walk.poses],
        poses,
        ..Problem::default()
    };
    for _ in 0..walk.points {
        add_point(&mut problem, walk, &mut dice);
    }
    hold_gauge(&mut problem);
    problem
}

/// Holds pose 0 and the coordinate in which pose 1 is furthest from it.
pub(crate) fn hold_gauge(problem: &mut Problem) {
    let baseline = problem.poses[1].centre() - problem.poses[0].centre();
    problem.pose_freedom[0] = PoseFreedom::Fixed;
    problem.pose_freedom[1] = PoseFreedom::CentreAxisFixed(baseline.iamax() as u8);
}

fn pose_on_circle(share: f64, dice: &mut Dice) -> Pose {
    let angle = share * std::f64::consts::TAU;
    let eye = Vector3::new(4.0 * libm::cos(angle), 4.0 * libm::sin(angle), 1.0) + vector(dice, 0.3);
    Pose::looking_at(eye, vector(dice, 0.2), -Vector3::z())
}

/// A point that at least two photos of a row see.
fn add_point(problem: &mut Problem, walk: &Walk, dice: &mut Dice) {
    let point = vector(dice, 1.0);
    let index = problem.points.len() as u32;
    // The square makes short tracks the rule, as in life.
    let share = dice.unit() * dice.unit();
    let length = (2 + (share * (walk.longest_track - 1) as f64) as usize).min(walk.poses);
    let first = dice.below(walk.poses);
    let mut photos: Vec<usize> = (0..length).map(|step| (first + step) % walk.poses).collect();
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

/// Uniform in a cube of twice the size.
pub(crate) fn vector(dice: &mut Dice, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| (2.0 * dice.unit() - 1.0) * size)
}

/// A pair of normal numbers (Box and Muller).
pub(crate) fn normal_pair(dice: &mut Dice) -> Vector2<f64> {
    let radius = (-2.0 * libm::log(1.0 - dice.unit())).sqrt();
    let angle = std::f64::consts::TAU * dice.unit();
    Vector2::new(radius * libm::cos(angle), radius * libm::sin(angle))
}

/// Adds normal noise to all pixels.
pub(crate) fn add_noise(problem: &mut Problem, sigma_px: f64, dice: &mut Dice) {
    for seen in &mut problem.observations {
        seen.pixel += normal_pair(dice) * sigma_px;
    }
}

/// Moves what may move: turns by `angle_rad`, centres and points by `distance`, each in a random direction.
pub(crate) fn disturb(problem: &mut Problem, angle_rad: f64, distance: f64, dice: &mut Dice) {
    for (pose, freedom) in problem.poses.iter_mut().zip(&problem.pose_freedom) {
        let mut offset = direction(dice) * distance;
        let turned = turn::exp(&(direction(dice) * angle_rad)) * pose.rotation;
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
        *point += direction(dice) * distance;
    }
}

fn direction(dice: &mut Dice) -> Vector3<f64> {
    let (a, b) = (normal_pair(dice), normal_pair(dice));
    Vector3::new(a.x, a.y, b.x).normalize()
}
