//! The box of a scene: the place of its origin, its size, and the size of its finest cells.

use marf_numeric::{quantile, upper_median};
use marf_scene::{Camera, Pose};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::{FieldError, View};

/// Cells a side of the finest level at most, where the scene decides it.
pub const MOST_FINEST: u32 = 8192;
/// Rays end here, in half sides of the box: beyond it a contracted cell of the finest level is not resolved.
pub const FAR: f64 = 512.0;
/// With cameras close together the box reaches this many baselines: there the disparity is still f / 16.
const BASELINES: f64 = 16.0;
/// Half sides of the box from its centre to a camera, at most: f32 still resolves 1/16 of one there.
const MOST_AWAY: f64 = 1e6;
/// Fewer sparse points say too little about the extent.
pub const ENOUGH_POINTS: usize = 32;

/// Place of the unit box in the world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frame {
    /// Centre, world units. Subtracted in f64 before anything becomes f32.
    pub origin: [f64; 3],
    /// Half side of the inner box, world units.
    pub half_side: f64,
    /// Typical distance from a camera to what it sees, world units.
    pub depth: f64,
    /// Why.
    pub reason: String,
}

/// A ray in the frame of the box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayStart {
    /// Camera centre, half sides.
    pub origin: [f32; 3],
    /// Unit vector.
    pub direction: [f32; 3],
}

impl Frame {
    /// Derives the box.
    ///
    /// With 32 points or more: centre = median, half side = 80th percentile of their distance (maximum norm).
    /// Else, if the optical axes meet in front of the cameras: centre = the point nearest to all axes, half
    /// side = the median distance to it. Else (panoramas): centre = mean of the cameras, half side = 16 times
    /// the median distance to the nearest other camera, at least 1.25 times their extent. 1 if all share one
    /// place.
    pub fn derive(views: &[View], points: &[[f64; 3]]) -> Self {
        let centres: Vec<_> = views.iter().map(|view| view.cam_from_world.centre()).collect();
        let found = from_points(views, points).or_else(|| from_axes(views, &centres));
        found.unwrap_or_else(|| from_baseline(&centres))
    }

    /// Derives the box from places that distances of pixels show, as from sparse points. `None` if they are too few, or at one place.
    pub fn around_shown(views: &[View], places: &[[f64; 3]]) -> Option<Self> {
        let frame = from_points(views, places)?;
        Some(Self {
            reason: format!(
                "pairs of photos show distances, whose places count as sparse points: {}",
                frame.reason
            ),
            ..frame
        })
    }

    /// Checks that f32 can distinguish the place of every camera in the box from others.
    ///
    /// # Errors
    /// [`FieldError::OutOfBox`] names the first that has none.
    pub fn check(&self, views: &[View]) -> Result<(), FieldError> {
        let place = |view: &View| self.inward(&view.cam_from_world.centre());
        let fits = |view: &&View| {
            let near = place(view).iter().all(|x| x.abs() <= MOST_AWAY);
            near && self.half_side.is_finite() && self.half_side > 0.0
        };
        match views.iter().find(|view| !fits(view)) {
            Some(view) => Err(FieldError::OutOfBox {
                id: view.id.clone(),
                place: place(view),
                half_side: self.half_side,
            }),
            None => Ok(()),
        }
    }

    /// Returns the ray behind a pixel, `None` where the distortion has no inverse.
    pub fn ray(&self, camera: &Camera, world_from_cam: &Pose, pixel: [f64; 2]) -> Option<RayStart> {
        let in_camera = camera.unproject(&Vector2::new(pixel[0], pixel[1]))?;
        let direction = world_from_cam.direction(&in_camera).normalize();
        let origin = self.inward(&world_from_cam.translation);
        Some(RayStart {
            origin: origin.map(|value| value as f32),
            direction: [direction.x as f32, direction.y as f32, direction.z as f32],
        })
    }

    /// Carries a point of the world into the box.
    pub fn inward(&self, point: &Vector3<f64>) -> [f64; 3] {
        [0, 1, 2].map(|axis| (point[axis] - self.origin[axis]) / self.half_side)
    }

    /// Carries a point of the box into the world.
    pub fn outward(&self, point: [f64; 3]) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| point[axis].mul_add(self.half_side, self.origin[axis]))
    }
}

fn from_points(views: &[View], points: &[[f64; 3]]) -> Option<Frame> {
    if points.len() < ENOUGH_POINTS {
        return None;
    }
    let (origin, half_side) = box_of(points);
    let depths = views.iter().map(|view| seen_depth(view, points));
    let depth = upper_median(depths.filter(|depth| *depth > 0.0)).unwrap_or_default();
    (half_side > 0.0 && depth > 0.0).then(|| Frame {
        origin,
        half_side,
        depth,
        reason: format!(
            "80 % of {} sparse points lie within {half_side:.4} of their median",
            points.len()
        ),
    })
}

/// Returns the median of points, and the 80th percentile of their distance from it in the maximum norm.
pub fn box_of(points: &[[f64; 3]]) -> ([f64; 3], f64) {
    let origin = [0, 1, 2].map(|axis| upper_median(points.iter().map(|p| p[axis])).unwrap_or_default());
    let reach = |p: &[f64; 3]| {
        (0..3)
            .map(|axis| (p[axis] - origin[axis]).abs())
            .fold(0.0, f64::max)
    };
    let half_side = quantile(points.iter().map(reach), 0.8).unwrap_or_default();
    (origin, half_side)
}

/// Returns the median depth of the points a view sees, 0 if none.
fn seen_depth(view: &View, points: &[[f64; 3]]) -> f64 {
    let depths = points
        .iter()
        .filter_map(|point| view.distance_of(&Vector3::from(*point)));
    upper_median(depths).unwrap_or_default()
}

fn from_axes(views: &[View], centres: &[Vector3<f64>]) -> Option<Frame> {
    let (mut system, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (view, centre) in views.iter().zip(centres) {
        let axis = view.cam_from_world.rotation.row(2).transpose();
        let across = Matrix3::identity() - axis * axis.transpose();
        system += across;
        right += across * centre;
    }
    let focus = system.try_inverse()? * right;
    let distances = centres.iter().map(|centre| (focus - centre).norm());
    let in_front = views
        .iter()
        .filter(|view| view.cam_from_world.point(&focus).z > 0.0)
        .count();
    let extent = extent(centres);
    let distance = upper_median(distances).unwrap_or_default();
    // Axes that meet much farther away than the cameras are apart are nearly parallel.
    let meets = in_front * 3 > views.len() * 2 && distance < 4.0 * extent && distance > 0.0;
    meets.then(|| Frame {
        origin: focus.into(),
        half_side: distance,
        depth: distance,
        reason: format!(
            "the optical axes of {in_front} of {} cameras meet in front of them, at a median distance of {distance:.4}",
            views.len()
        ),
    })
}

fn from_baseline(centres: &[Vector3<f64>]) -> Frame {
    let nearest = centres.iter().enumerate().filter_map(|(one, centre)| {
        let others = centres.iter().enumerate().filter(|(other, _)| *other != one);
        let apart = others
            .map(|(_, other)| (other - centre).norm())
            .filter(|apart| *apart > 1e-9);
        apart.min_by(f64::total_cmp)
    });
    let baseline = upper_median(nearest).unwrap_or_default();
    let origin = centres.iter().sum::<Vector3<f64>>() / centres.len().max(1) as f64;
    let half_side = (BASELINES * baseline).max(1.25 * extent(centres));
    let (half_side, reason) = if half_side > 0.0 {
        let reason = format!("no sparse points and no common focus: {BASELINES} baselines of {baseline:.4}");
        (half_side, reason)
    } else {
        (1.0, "all cameras share one place: one world unit".to_owned())
    };
    Frame {
        origin: origin.into(),
        half_side,
        depth: half_side,
        reason,
    }
}

/// Returns the largest distance of a camera from their mean.
fn extent(centres: &[Vector3<f64>]) -> f64 {
    let mean = centres.iter().sum::<Vector3<f64>>() / centres.len().max(1) as f64;
    centres
        .iter()
        .map(|centre| (centre - mean).norm())
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::Image;

    fn view(eye: Vector3<f64>, target: Vector3<f64>) -> View {
        View {
            id: "v".to_owned(),
            camera: Camera::pinhole(32, 24, 40.0),
            cam_from_world: Pose::looking_at(eye, target, -Vector3::z()),
            image: Image::from_fn(32, 24, |_, _| [9; 3]).into(),
            distances: Vec::new(),
        }
    }

    fn ring(count: u32, radius: f64, centre: Vector3<f64>) -> Vec<View> {
        let angles = (0..count).map(|index| f64::from(index) / f64::from(count) * std::f64::consts::TAU);
        angles
            .map(|angle| {
                view(
                    centre + Vector3::new(radius * angle.cos(), radius * angle.sin(), 0.5),
                    centre,
                )
            })
            .collect()
    }

    #[test]
    fn a_walk_around_is_centred_on_what_all_cameras_look_at() {
        let centre = Vector3::new(1e6, -2e6, 30.0);
        let frame = Frame::derive(&ring(12, 3.0, centre), &[]);
        assert!((Vector3::from(frame.origin) - centre).norm() < 1e-3, "{frame:?}");
        assert!((frame.half_side - 9.25_f64.sqrt()).abs() < 1e-3, "{frame:?}");
        // Far from the origin of the world a ray still starts within 1e-6 half sides of its camera.
        let views = ring(12, 3.0, centre);
        let ray = frame
            .ray(&views[0].camera, &views[0].cam_from_world.inverse(), [16.0, 12.0])
            .unwrap();
        let toward: f32 = (0..3).map(|axis| ray.origin[axis] * ray.direction[axis]).sum();
        assert!((toward + 1.0).abs() < 1e-5, "{ray:?}");
    }

    #[test]
    fn a_stereo_panorama_reaches_sixteen_baselines() {
        let looks = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];
        let views: Vec<_> = looks
            .iter()
            .flat_map(|[x, y]| {
                let ahead = Vector3::new(*x, *y, 0.0);
                let aside = Vector3::new(-*y, *x, 0.0) * 0.12;
                [view(aside, aside + ahead), view(-aside, -aside + ahead)]
            })
            .collect();
        let frame = Frame::derive(&views, &[]);
        // The nearest other camera of a square of side 0.17 is 0.17 away.
        assert!(
            (frame.half_side - 16.0 * 0.12 * 2.0_f64.sqrt()).abs() < 1e-6,
            "{frame:?}"
        );
    }

    #[test]
    fn one_camera_gets_a_box_of_one_unit() {
        let frame = Frame::derive(&[view(Vector3::new(5.0, 5.0, 5.0), Vector3::zeros())], &[]);
        assert!(
            frame.origin.iter().all(|x| (x - 5.0).abs() < 1e-9) && frame.half_side == 1.0,
            "{frame:?}"
        );
    }

    #[test]
    fn points_decide_where_there_are_enough() {
        let points: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i) / 10.0, 2.0, 2.0]).collect();
        let frame = Frame::derive(&ring(6, 30.0, Vector3::new(5.0, 2.0, 2.0)), &points);
        assert!(
            (frame.origin[0] - 5.0).abs() < 0.11 && (frame.half_side - 4.0).abs() < 0.2,
            "{frame:?}"
        );
    }
}
