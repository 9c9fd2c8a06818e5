use marf_numeric::upper_median;
use nalgebra::Vector3;

use crate::{Camera, Point, Pose};

/// Cameras and points that the distance is taken of, at most: medians of more are the same.
const MOST_CAMERAS: usize = 64;
const MOST_POINTS: usize = 512;
/// Fewest sparse points from which a distance is computed.
const ENOUGH_POINTS: usize = 32;
/// Without points cameras close together see this many of their distances far: there the disparity is still f / 16.
const BASELINES: f64 = 16.0;

/// A camera and its pose.
pub(crate) type Posed<'a> = (&'a Camera, &'a Pose);

/// Returns whether a photo of the camera shows a point of the world, whatever may be between.
pub(crate) fn shows(posed: Posed<'_>, point: &Vector3<f64>) -> bool {
    let (camera, cam_from_world) = posed;
    camera.project_inside(&cam_from_world.point(point)).is_some()
}

/// Returns the typical distance from a camera to what it shows, world units, above 0.
///
/// With sparse points it is the median over cameras of the median distance of the points that each shows. Without them it is the larger of
/// two lengths: the cameras' median distance from their middle, and 16 times their median distance to the nearest other camera. It is 1 if
/// all are at one place.
pub(crate) fn reach(cameras: &[Posed<'_>], points: &[Point]) -> f64 {
    let some = strided(cameras, MOST_CAMERAS);
    let seen = seen_distance(&some, points);
    let found = seen.unwrap_or_else(|| from_cameras(cameras));
    if found > 0.0 && found.is_finite() {
        found
    } else {
        1.0
    }
}

/// Returns at most `most` of the values, evenly spaced.
fn strided<T: Copy>(values: &[T], most: usize) -> Vec<T> {
    let stride = values.len().div_ceil(most).max(1);
    values.iter().step_by(stride).copied().collect()
}

fn seen_distance(cameras: &[Posed<'_>], points: &[Point]) -> Option<f64> {
    if points.len() < ENOUGH_POINTS {
        return None;
    }
    let stride = points.len().div_ceil(MOST_POINTS);
    let points: Vec<Vector3<f64>> = points
        .iter()
        .step_by(stride)
        .map(|point| Vector3::from(point.position))
        .collect();
    let of_camera = |posed: &Posed<'_>| {
        let shown = points.iter().filter(|point| shows(*posed, point));
        upper_median(shown.map(|point| posed.1.point(point).norm()))
    };
    upper_median(cameras.iter().filter_map(of_camera))
}

fn from_cameras(cameras: &[Posed<'_>]) -> f64 {
    let centres: Vec<Vector3<f64>> = cameras.iter().map(|(_, pose)| pose.centre()).collect();
    let axis = |axis: usize| upper_median(centres.iter().map(|centre| centre[axis])).unwrap_or(0.0);
    let middle = Vector3::new(axis(0), axis(1), axis(2));
    let spread = upper_median(centres.iter().map(|centre| (centre - middle).norm()));
    let nearest = strided(&centres, MOST_CAMERAS).into_iter().filter_map(|centre| {
        let apart = centres.iter().map(|other| (other - centre).norm());
        apart.filter(|apart| *apart > 0.0).min_by(f64::total_cmp)
    });
    let baseline = upper_median(nearest).unwrap_or(0.0);
    spread.unwrap_or(0.0).max(BASELINES * baseline)
}
