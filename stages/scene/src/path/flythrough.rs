//! Smooth paths: a fly-through along training cameras, or through any cameras in their order.

use marf_numeric::lower_median;
use nalgebra::{Quaternion, Rotation3, SVector, UnitQuaternion, Vector3, Vector4};

use super::{Viewpoint, forward, mean, numbered, training, typical_camera};
use crate::{Camera, Pose, Scene};

/// Most training cameras that the path passes through.
const MAX_KEYS: usize = 8;
/// Two cameras with a smaller [`camera_distance`] are at one place.
const SAME_PLACE: f64 = 1e-6;

/// Returns a smooth open path of `frames` viewpoints that passes through training cameras.
///
/// Up to eight cameras that are far apart are joined by their shortest tour. Between them position and rotation follow cubic Hermite curves
/// with even speed, with the horizon of the photos.
///
/// Extremes: one camera, or all at one place, gives that camera `frames` times. Without a camera there is no viewpoint.
pub fn flythrough(scene: &Scene, frames: u32, width: u32) -> Vec<Viewpoint> {
    let poses: Vec<Pose> = training(scene).iter().map(|frame| frame.cam_from_world).collect();
    let Some(keys) = keys(&poses) else {
        return Vec::new();
    };
    numbered(typical_camera(scene, width), along(&keys, frames).into_iter())
}

/// Returns a smooth open path of `frames` viewpoints of one camera that passes through poses in their order, from the first to the last.
///
/// Between them it is as [`flythrough`]. Extremes: consecutive poses with the same place and direction count once. A single pose is
/// returned `frames` times. Without a pose there is no viewpoint.
pub fn through(poses: &[Pose], camera: Camera, frames: u32) -> Vec<Viewpoint> {
    let spread = spread(poses).unwrap_or(0.0);
    let mut keys = Keys {
        poses: poses.to_vec(),
        spread,
    };
    keys.poses
        .dedup_by(|next, last| camera_distance(last, next, spread) <= SAME_PLACE);
    numbered(camera, along(&keys, frames).into_iter())
}

/// The cameras that the path passes through, in its order.
struct Keys {
    poses: Vec<Pose>,
    /// Median distance of all cameras from their mean centre.
    spread: f64,
}

/// Returns poses on the curve through the keys with even speed. Empty without keys.
fn along(keys: &Keys, frames: u32) -> Vec<Pose> {
    let knots = knots(&keys.poses, keys.spread);
    let Some(last) = knots.last().map(|knot| knot.at) else {
        return Vec::new();
    };
    let steps = f64::from(frames.saturating_sub(1).max(1));
    let at = |index| last * f64::from(index) / steps;
    (0..frames).map(|index| pose_at(&knots, at(index))).collect()
}

/// Returns the median distance of poses from their mean centre, or `None` without poses.
fn spread(poses: &[Pose]) -> Option<f64> {
    let middle = mean(poses.iter().map(Pose::centre));
    lower_median(poses.iter().map(|pose| (pose.centre() - middle).norm()))
}

/// A knot of the path's splines.
struct Knot {
    /// Distance travelled up to here, in units of [`camera_distance`].
    at: f64,
    /// Camera centre.
    centre: Vector3<f64>,
    /// Rotation `cam_from_world` as a quaternion.
    turn: Vector4<f64>,
}

/// Returns the distance of two cameras: of their centres in units of `spread`, plus the chord between the directions.
fn camera_distance(a: &Pose, b: &Pose, spread: f64) -> f64 {
    let moved = if spread > 0.0 {
        (a.centre() - b.centre()).norm() / spread
    } else {
        0.0
    };
    moved + (forward(a) - forward(b)).norm()
}

/// Chooses cameras far from each other and orders them as a short tour. `None` without cameras.
fn keys(poses: &[Pose]) -> Option<Keys> {
    let middle = mean(poses.iter().map(Pose::centre));
    let spread = spread(poses)?;
    let first = farthest(poses, |pose| (pose.centre() - middle).norm())?;
    let mut chosen = vec![first];
    while chosen.len() < MAX_KEYS {
        let nearest = |pose: &Pose| {
            let distances = chosen
                .iter()
                .map(|&key| camera_distance(pose, &poses[key], spread));
            distances.fold(f64::INFINITY, f64::min)
        };
        match farthest(poses, nearest) {
            Some(next) if nearest(&poses[next]) > SAME_PLACE => chosen.push(next),
            _ => break,
        }
    }
    let mut order = tour(&chosen, |a, b| camera_distance(&poses[a], &poses[b], spread));
    // The same set of cameras always gives the same direction of the tour.
    if order.first() > order.last() {
        order.reverse();
    }
    Some(Keys {
        poses: order.into_iter().map(|key| poses[key]).collect(),
        spread,
    })
}

/// Returns the first index with the largest value, or `None` without poses.
fn farthest(poses: &[Pose], value: impl Fn(&Pose) -> f64) -> Option<usize> {
    let values = poses.iter().map(value).enumerate();
    values
        .reduce(|best, next| if next.1 > best.1 { next } else { best })
        .map(|(index, _)| index)
}

/// Returns an open tour that no reversal of a part makes shorter (2-opt).
fn tour(places: &[usize], distance: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    let mut order = places.to_vec();
    let length = |order: &[usize]| {
        order
            .windows(2)
            .map(|pair| distance(pair[0], pair[1]))
            .sum::<f64>()
    };
    let mut best = length(&order);
    let mut improved = true;
    while improved {
        improved = false;
        for from in 0..order.len() {
            for to in from + 1..order.len() {
                order[from..=to].reverse();
                let now = length(&order);
                if now < best - 1e-12 {
                    (best, improved) = (now, true);
                } else {
                    order[from..=to].reverse();
                }
            }
        }
    }
    order
}

/// Returns the knots of the poses.
fn knots(keys: &[Pose], spread: f64) -> Vec<Knot> {
    let mut knots: Vec<Knot> = Vec::with_capacity(keys.len());
    for (index, pose) in keys.iter().enumerate() {
        let mut turn = quaternion(pose);
        let mut at = 0.0;
        if let Some(before) = knots.last() {
            // q and -q are one rotation. The nearer one keeps the curve short.
            turn *= if before.turn.dot(&turn) < 0.0 { -1.0 } else { 1.0 };
            at = before.at + camera_distance(&keys[index - 1], pose, spread);
        }
        knots.push(Knot {
            at,
            centre: pose.centre(),
            turn,
        });
    }
    knots
}

/// Returns the rotation of a pose as a quaternion.
fn quaternion(pose: &Pose) -> Vector4<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation)).coords
}

/// Returns the pose at a distance along the path.
fn pose_at(knots: &[Knot], at: f64) -> Pose {
    let after = knots.iter().position(|knot| knot.at > at);
    let last = knots.len() - 1;
    let low = after.map_or(last.saturating_sub(1), |after| after - 1);
    let high = (low + 1).min(last);
    let centre = hermite(knots, low, high, at, |knot| knot.centre);
    let turn = hermite(knots, low, high, at, |knot| knot.turn);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::from(turn))
        .to_rotation_matrix()
        .into_inner();
    Pose {
        rotation,
        translation: -(rotation * centre),
    }
}

/// Returns a value of the cubic Hermite curve between two knots, with the tangents of [`slope`].
fn hermite<const N: usize>(
    knots: &[Knot],
    low: usize,
    high: usize,
    at: f64,
    value: impl Fn(&Knot) -> SVector<f64, N>,
) -> SVector<f64, N> {
    let span = knots[high].at - knots[low].at;
    if span <= 0.0 {
        return value(&knots[low]);
    }
    let t = (at - knots[low].at) / span;
    let (t2, t3) = (t * t, t * t * t);
    value(&knots[low]) * (2.0 * t3 - 3.0 * t2 + 1.0)
        + slope(knots, low, &value) * (span * (t3 - 2.0 * t2 + t))
        + value(&knots[high]) * (3.0 * t2 - 2.0 * t3)
        + slope(knots, high, &value) * (span * (t3 - t2))
}

/// Returns the slope at a knot of the parabola through it and its two neighbours. At an end it is the slope of the end's parabola.
fn slope<const N: usize>(
    knots: &[Knot],
    index: usize,
    value: &impl Fn(&Knot) -> SVector<f64, N>,
) -> SVector<f64, N> {
    let rise = |low: usize| {
        let span = knots[low + 1].at - knots[low].at;
        (value(&knots[low + 1]) - value(&knots[low])) / span
    };
    let last = knots.len() - 1;
    match index {
        _ if last == 1 => rise(0),
        0 => rise(0) * 2.0 - slope(knots, 1, value),
        end if end == last => rise(last - 1) * 2.0 - slope(knots, last - 1, value),
        _ => {
            let before = knots[index].at - knots[index - 1].at;
            let after = knots[index + 1].at - knots[index].at;
            (rise(index - 1) * after + rise(index) * before) / (before + after)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::ring;
    use super::*;

    #[test]
    fn the_path_starts_and_ends_at_training_cameras_and_never_jumps() {
        let scene = ring(24);
        let path = flythrough(&scene, 60, 200);
        assert_eq!(path.len(), 60);
        assert_eq!((path[0].name.as_str(), path[59].name.as_str()), ("0001", "0060"));
        let at_a_camera = |pose: &Pose| {
            let cameras = training(&scene);
            cameras
                .iter()
                .any(|frame| (frame.cam_from_world.centre() - pose.centre()).norm() < 1e-9)
        };
        assert!(at_a_camera(&path[0].cam_from_world) && at_a_camera(&path[59].cam_from_world));
        for pair in path.windows(2) {
            let step = (pair[0].cam_from_world.centre() - pair[1].cam_from_world.centre()).norm();
            // Half a circle of radius 4 in 59 steps is 0.21 a step.
            assert!(step < 0.3, "{} to {}: {step}", pair[0].name, pair[1].name);
        }
    }

    #[test]
    fn the_path_stays_near_the_ring_and_looks_inwards() {
        for place in flythrough(&ring(24), 40, 200) {
            let pose = place.cam_from_world;
            assert!(pose.is_valid(), "{}", place.name);
            let seen = pose.point(&Vector3::x());
            assert!(
                (seen.norm() - 17_f64.sqrt()).abs() < 0.15,
                "{}: {}",
                place.name,
                seen.norm()
            );
            assert!(seen.z / seen.norm() > 0.99, "{}: {seen}", place.name);
        }
    }

    #[test]
    fn one_camera_stands_still_and_no_camera_has_no_path() {
        let still = flythrough(&ring(1), 5, 100);
        assert_eq!(still.len(), 5);
        assert!((still[0].cam_from_world.centre() - still[4].cam_from_world.centre()).norm() < 1e-12);
        assert!(flythrough(&ring(0), 5, 100).is_empty());
        assert_eq!(flythrough(&ring(24), 1, 100).len(), 1);
        assert!(flythrough(&ring(24), 0, 100).is_empty());
    }

    #[test]
    fn a_tour_has_no_crossings() {
        let places = [0, 3, 1, 4, 2];
        let order = tour(&places, |a, b| (a as f64 - b as f64).abs());
        assert!(order == [0, 1, 2, 3, 4] || order == [4, 3, 2, 1, 0], "{order:?}");
    }

    #[test]
    fn a_path_through_cameras_visits_each_in_its_order() {
        let poses: Vec<Pose> = ring(3).frames.iter().map(|frame| frame.cam_from_world).collect();
        let camera = Camera::pinhole(40, 30, 32.0);
        let path = through(&poses, camera, 101);
        assert_eq!((path.len(), path[0].camera), (101, camera));
        let nearest = |pose: &Pose| {
            let off = |place: &Viewpoint| {
                let apart = (place.cam_from_world.centre() - pose.centre()).norm();
                apart + (place.cam_from_world.rotation - pose.rotation).norm()
            };
            let found = path.iter().enumerate().map(|(index, place)| (off(place), index));
            found.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
        };
        let visits: Vec<(f64, usize)> = poses.iter().map(nearest).collect();
        assert_eq!((visits[0].1, visits[2].1), (0, 100), "{visits:?}");
        assert!(
            visits[0].1 < visits[1].1 && visits[1].1 < visits[2].1,
            "{visits:?}"
        );
        // A step is a hundredth of the way, 0.07 of centre and direction.
        assert!(visits.iter().all(|(off, _)| *off < 0.1), "{visits:?}");
    }

    #[test]
    fn a_path_through_a_turning_camera_turns_and_equal_cameras_count_once() {
        let camera = Camera::pinhole(40, 30, 32.0);
        let eye = Vector3::new(1.0, 2.0, 3.0);
        let look = |side: Vector3<f64>| Pose::looking_at(eye, eye + side, Vector3::z());
        let turn = [look(Vector3::x()), look(Vector3::x()), look(Vector3::y())];
        let path = through(&turn, camera, 3);
        for place in &path {
            assert!(place.cam_from_world.is_valid(), "{place:?}");
            assert!((place.cam_from_world.centre() - eye).norm() < 1e-12, "{place:?}");
        }
        // Half way between x and y.
        let middle = forward(&path[1].cam_from_world);
        assert!(
            (middle - Vector3::new(0.5_f64.sqrt(), 0.5_f64.sqrt(), 0.0)).norm() < 1e-9,
            "{middle}"
        );
        assert_eq!(through(&turn[..1], camera, 4).len(), 4);
        assert!(through(&[], camera, 4).is_empty() && through(&turn, camera, 0).is_empty());
    }
}
