//! An orbit around the point that the training cameras look at.

use marf_numeric::lower_median;
use nalgebra::{Matrix3, Vector3};

use super::{Viewpoint, forward, mean, numbered, training, typical_camera};
use crate::{Frame, Pose, Scene};

/// Least determinant of the normal matrix (its diagonal is at most 1) at which views count as converging. 1e-4 is a spread of about half a
/// degree in one direction or 1 degree in both.
const CONVERGING: f64 = 1e-4;
/// Cameras whose mean direction from the target is shorter than this are all around it.
const ALL_AROUND: f64 = 0.5;

/// Shortest mean of the cameras' up directions that still is one.
const LEAST_UP: f64 = 1e-9;

/// Returns `frames` viewpoints that circle the point the training cameras look at.
///
/// Distance and height are the median ones of the cameras. If the cameras are all around the point, the path is a full circle. Otherwise it
/// swings between the outermost cameras, so that it stays where photos were taken. Up is that of [`up_direction`], else z. Extremes: no
/// camera gives no viewpoint.
pub fn orbit(scene: &Scene, frames: u32, width: u32) -> Vec<Viewpoint> {
    let cameras = training(scene);
    if cameras.is_empty() {
        return Vec::new();
    }
    let target = focus_point(scene);
    let up = up_direction(scene).unwrap_or_else(Vector3::z);
    let circle = Circle::around(&target, &up, &cameras);
    let path = (0..frames).map(|index| {
        let eye = circle.eye(f64::from(index) / f64::from(frames));
        Pose::looking_at(eye, target, -up)
    });
    numbered(typical_camera(scene, width), path)
}

/// Returns the point nearest to all axes of view of the training cameras, in the world.
///
/// Where the views are parallel or diverge (a panorama) it is a point ahead of the cameras, at the median
/// distance of the sparse points, or at three times the cameras' spread if there are none.
pub fn focus_point(scene: &Scene) -> Vector3<f64> {
    let cameras = training(scene);
    converging_point(&cameras).unwrap_or_else(|| point_ahead(scene, &cameras))
}

/// Returns the point with the least sum of squared distances to the viewing axes, or `None` if they do not converge.
///
/// Solves Σ (I - d dᵀ) x = Σ (I - d dᵀ) c over axes with direction d through c.
fn converging_point(cameras: &[&Frame]) -> Option<Vector3<f64>> {
    let count = cameras.len().max(1) as f64;
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for camera in cameras {
        let axis = forward(&camera.cam_from_world);
        let across = (Matrix3::identity() - axis * axis.transpose()) / count;
        normal += across;
        right += across * camera.cam_from_world.centre();
    }
    if normal.determinant() < CONVERGING {
        return None;
    }
    let point = normal.try_inverse()? * right;
    let ahead = cameras
        .iter()
        .filter(|camera| camera.cam_from_world.point(&point).z > 0.0);
    (2 * ahead.count() > cameras.len()).then_some(point)
}

/// Returns a point ahead of the cameras, as [`focus_point`] says.
fn point_ahead(scene: &Scene, cameras: &[&Frame]) -> Vector3<f64> {
    let centre = mean(cameras.iter().map(|camera| camera.cam_from_world.centre()));
    let ahead = mean(cameras.iter().map(|camera| forward(&camera.cam_from_world)));
    let ahead = ahead.try_normalize(1e-6).unwrap_or_else(Vector3::x);
    let points = scene.points.iter();
    let to_points = lower_median(points.map(|point| (Vector3::from(point.position) - centre).norm()));
    let spread = lower_median(
        cameras
            .iter()
            .map(|camera| (camera.cam_from_world.centre() - centre).norm()),
    );
    let range = to_points.or(spread.map(|spread| 3.0 * spread)).unwrap_or(0.0);
    centre + ahead * if range > 0.0 { range } else { 1.0 }
}

/// Returns the up direction of the scene as a unit vector. If it is unknown, returns the mean of the training cameras, or `None` where
/// these cancel each other out.
pub fn up_direction(scene: &Scene) -> Option<Vector3<f64>> {
    let rows: Vec<Vector3<f64>> = training(scene)
        .iter()
        .map(|camera| -camera.cam_from_world.rotation.row(1).transpose())
        .collect();
    let known = scene.up.map(Vector3::from);
    known
        .unwrap_or_else(|| mean(rows.into_iter()))
        .try_normalize(LEAST_UP)
}

/// The circle of an orbit.
struct Circle {
    centre: Vector3<f64>,
    radius: f64,
    /// Unit vectors in the plane of the circle. The first points to the middle of the cameras.
    along: Vector3<f64>,
    across: Vector3<f64>,
    /// Tangent of the half angle of the swing. `None` for a full circle.
    swing: Option<f64>,
}

impl Circle {
    /// Returns the circle around `target` at the median distance and height of the cameras.
    fn around(target: &Vector3<f64>, up: &Vector3<f64>, cameras: &[&Frame]) -> Self {
        let offsets: Vec<Vector3<f64>> = cameras
            .iter()
            .map(|camera| camera.cam_from_world.centre() - target)
            .collect();
        let flat = |offset: &Vector3<f64>| offset - up * offset.dot(up);
        let sides: Vec<Vector3<f64>> = offsets
            .iter()
            .filter_map(|offset| flat(offset).try_normalize(1e-12))
            .collect();
        let middle = mean(sides.iter().copied());
        let along = middle
            .try_normalize(1e-9)
            .or_else(|| sides.first().copied())
            .unwrap_or_else(|| any_orthogonal(up));
        let widest = sides.iter().map(|side| side.dot(&along)).fold(1.0, f64::min);
        let height = lower_median(offsets.iter().map(|offset| offset.dot(up))).unwrap_or(0.0);
        let radius = lower_median(offsets.iter().map(|offset| flat(offset).norm())).unwrap_or(1.0);
        Self {
            centre: target + up * height,
            radius,
            along,
            across: up.cross(&along),
            // Beyond 80 degrees to a side (cos 0.17) the tangent grows without limit. The swing ends there.
            swing: (middle.norm() >= ALL_AROUND).then(|| {
                let cos = widest.clamp(0.17, 1.0);
                ((1.0 - cos * cos) / (cos * cos)).sqrt()
            }),
        }
    }

    /// Returns the camera centre after a share of the orbit in [0, 1].
    fn eye(&self, share: f64) -> Vector3<f64> {
        let (cos, sin) = turn(share);
        let side = match self.swing {
            None => self.along * cos + self.across * sin,
            Some(tan) => {
                let side = self.along + self.across * (tan * sin);
                side.try_normalize(1e-12).unwrap_or(self.along)
            }
        };
        self.centre + side * self.radius
    }
}

/// Returns a unit vector orthogonal to `up`.
fn any_orthogonal(up: &Vector3<f64>) -> Vector3<f64> {
    let sideways = up.cross(&Vector3::x()).try_normalize(1e-3);
    sideways.unwrap_or_else(|| up.cross(&Vector3::y()).normalize())
}

/// Returns cosine and sine of a share of a full turn, for shares in [0, 1].
///
/// Taylor series over an eighth of a turn (error below 1e-15), because library functions differ between machines.
pub(super) fn turn(share: f64) -> (f64, f64) {
    let eighths = share * 8.0;
    let octant = eighths as u64;
    let (octant, rest) = if octant.is_multiple_of(2) {
        (octant, eighths - octant as f64)
    } else {
        (octant + 1, eighths - (octant + 1) as f64)
    };
    let angle = rest * std::f64::consts::FRAC_PI_4;
    let square = angle * angle;
    let series = |first: f64, start: u32| {
        let (mut term, mut sum) = (first, first);
        for k in 0..9 {
            let next = f64::from(start + 2 * k);
            term *= -square / (next * (next + 1.0));
            sum += term;
        }
        sum
    };
    let (cos, sin) = (series(1.0, 1), series(angle, 2));
    match octant % 8 {
        0 => (cos, sin),
        2 => (-sin, cos),
        4 => (-cos, -sin),
        _ => (sin, -cos),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::ring;
    use super::*;

    #[test]
    fn a_share_of_a_turn_has_the_cosine_and_sine_of_its_angle() {
        for step in 0..=96 {
            let share = f64::from(step) / 96.0;
            let (cos, sin) = turn(share);
            let angle = share * std::f64::consts::TAU;
            // A few units in the last place of numbers up to 1.
            assert!((cos - angle.cos()).abs() < 2e-15, "{share}: {cos}");
            assert!((sin - angle.sin()).abs() < 2e-15, "{share}: {sin}");
        }
    }

    #[test]
    fn the_focus_of_a_ring_is_its_centre() {
        assert!((focus_point(&ring(16)) - Vector3::x()).norm() < 1e-9);
    }

    #[test]
    fn parallel_views_focus_ahead() {
        let mut scene = ring(9);
        for (index, frame) in scene.frames.iter_mut().enumerate() {
            let eye = Vector3::new(index as f64, 0.0, 0.0);
            frame.cam_from_world = Pose::looking_at(eye, eye + Vector3::y(), Vector3::z());
        }
        let focus = focus_point(&scene);
        assert!(
            focus.y > 1.0 && focus.iter().all(|value| value.is_finite()),
            "{focus}"
        );
    }

    #[test]
    fn an_orbit_of_half_a_ring_swings_inside_it_with_the_target_ahead() {
        let scene = ring(24);
        let path = orbit(&scene, 32, 100);
        assert_eq!(path.len(), 32);
        for place in &path {
            let seen = place.cam_from_world.point(&Vector3::x());
            assert!(
                seen.x.abs() < 1e-9 && seen.y.abs() < 1e-9,
                "{}: {seen}",
                place.name
            );
            let eye = place.cam_from_world.centre();
            assert!(eye.y > 0.0 && (eye.z + 1.0).abs() < 1e-9, "{}: {eye}", place.name);
        }
    }

    #[test]
    fn an_orbit_without_photos_is_empty() {
        assert!(orbit(&ring(0), 3, 100).is_empty());
    }

    #[test]
    fn up_is_that_of_the_scene_or_of_the_photos_unless_they_cancel_out() {
        let mut scene = ring(2);
        assert_eq!(up_direction(&scene), Some(-Vector3::z()));
        scene.up = None;
        let of_photos = up_direction(&scene).unwrap();
        assert!(of_photos.z < -0.9, "{of_photos}");
        let upside_down = |pose: &Pose| {
            let half_turn = nalgebra::Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
            Pose {
                rotation: half_turn * pose.rotation,
                translation: half_turn * pose.translation,
            }
        };
        scene.frames[1] = scene.frames[0].clone();
        scene.frames[1].cam_from_world = upside_down(&scene.frames[0].cam_from_world);
        assert_eq!(up_direction(&scene), None);
        assert_eq!(up_direction(&ring(0)), Some(-Vector3::z()));
    }
}
