//! The depths of one photo, from all pairs that it is in.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

use crate::disparities::Class;
use crate::kept::Sample;
use crate::pairs::MOST_PAIRS;
use crate::raster::Raster;
use crate::rectify::{Eye, Rectified};

/// Two inverse depths agree within this share, or within this number of standard deviations of their difference.
const SAME_SHARE: f32 = 0.01;
const SAME_SIGMAS: f32 = 2.5;
/// An inverse depth of fewer standard deviations can be that of infinity.
const FAR_SIGMAS: f32 = 3.0;

/// What one pair says about a photo.
pub(crate) struct PairView {
    pub samples: Raster<Sample>,
    pub rectified: Rectified,
    /// The eye of the photo.
    pub eye: Eye,
}

/// A plane that a pixel shows, in the axes of the photo: n · x = 1 for its points x. Along the ray (X, Y, 1) its inverse depth is
/// n · (X, Y, 1).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Plane {
    normal: Vector3<f32>,
    inverse: f32,
    /// One standard deviation of the inverse depth.
    sigma: f32,
    edge: bool,
}

/// Depths of a photo. All lists are `[height * width]`, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PhotoDepth {
    /// The camera, shrunk.
    pub camera: Camera,
    /// The inverse of the depth along the axis, 0 without one. Inverse units of the world.
    pub inverse: Vec<f32>,
    /// One standard deviation of it.
    pub sigma: Vec<f32>,
    /// The plane at each pixel in the axes of the photo: n · x = 1.
    pub normal: Vec<[f32; 3]>,
    pub class: Vec<Class>,
}

/// Merges what the pairs of a photo say about each of its pixels.
///
/// Pairs agree if their inverse depths differ by at most 1 % or 2.5 standard deviations. The largest group that agrees with one pair
/// decides, by the weights 1 / sigma^2, and it confirms the depth if it has two pairs. One pair alone counts only where no other
/// differs.
pub(crate) fn merge(camera: Camera, pairs: &[PairView]) -> PhotoDepth {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let pixel = |index: usize| {
        let at = Vector2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let Some(ray) = camera.unproject(&at) else {
            return PixelDepth::NONE;
        };
        let mut planes = [None; MOST_PAIRS];
        for (plane, pair) in planes.iter_mut().zip(pairs) {
            *plane = plane_at(pair, &ray);
        }
        decide(&planes)
    };
    let merged: Vec<PixelDepth> = (0..width * height).into_par_iter().map(pixel).collect();
    PhotoDepth {
        camera,
        inverse: merged.iter().map(|one| one.inverse).collect(),
        sigma: merged.iter().map(|one| one.sigma).collect(),
        normal: merged.iter().map(|one| one.normal.into()).collect(),
        class: merged.iter().map(|one| one.class).collect(),
    }
}

/// Returns what a pair says along the ray (X, Y, 1) of a photo.
fn plane_at(pair: &PairView, ray: &Vector3<f64>) -> Option<Plane> {
    let photo_from_rectified: &Matrix3<f64> = &pair.eye.photo_from_rectified;
    let camera = &pair.eye.camera;
    let turned = photo_from_rectified.tr_mul(ray);
    let at = camera.project(&turned)?;
    let above = pair.eye.rows_above(at);
    let (x, y) = (at.x.floor(), (at.y - above).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < f64::from(camera.width) && y < f64::from(camera.height);
    if !inside {
        return None;
    }
    let sample = pair.samples.at(x as usize, y as usize);
    if !sample.is_some() {
        return None;
    }
    let (slope_x, slope_y) = (f64::from(sample.slope_x), f64::from(sample.slope_y));
    // The middle of the sample, on the plane z = 1 of the cameras.
    let middle = Vector2::new(x + 0.5 - camera.cx_px, y + 0.5 + above - camera.cy_px) / camera.fx_px;
    let (a, b) = (
        slope_x / pair.rectified.baseline,
        slope_y / pair.rectified.baseline,
    );
    let c = pair.rectified.inverse_depth(f64::from(sample.disparity)) - a * middle.x - b * middle.y;
    let normal = photo_from_rectified * Vector3::new(a, b, c);
    let inverse = normal.dot(ray) as f32;
    let per_px = turned.z / (pair.rectified.focal_px * pair.rectified.baseline);
    let sigma = (per_px * f64::from(sample.sigma)) as f32;
    (inverse > FAR_SIGMAS * sigma).then(|| Plane {
        normal: normal.map(|value| value as f32),
        inverse,
        sigma,
        edge: sample.edge,
    })
}

/// A pixel of a photo.
#[derive(Clone, Copy)]
struct PixelDepth {
    inverse: f32,
    sigma: f32,
    normal: Vector3<f32>,
    class: Class,
}

impl PixelDepth {
    const NONE: Self = Self {
        inverse: 0.0,
        sigma: 0.0,
        normal: Vector3::new(0.0, 0.0, 0.0),
        class: Class::None,
    };
}

fn agree(a: &Plane, b: &Plane) -> bool {
    let apart = (a.inverse - b.inverse).abs();
    let sigma = (a.sigma * a.sigma + b.sigma * b.sigma).sqrt();
    apart <= (SAME_SHARE * a.inverse.max(b.inverse)).max(SAME_SIGMAS * sigma)
}

/// Decides a pixel. Of equal groups that of the pair with the smallest standard deviation wins, then the first.
fn decide(planes: &[Option<Plane>; MOST_PAIRS]) -> PixelDepth {
    let known = || planes.iter().flatten();
    let votes = |one: &Plane| known().filter(|other| agree(one, other)).count();
    let mut best: Option<(&Plane, usize)> = None;
    for plane in known() {
        let count = votes(plane);
        let wins =
            best.is_none_or(|(other, most)| count > most || (count == most && plane.sigma < other.sigma));
        if wins {
            best = Some((plane, count));
        }
    }
    let Some((best, count)) = best else {
        return PixelDepth::NONE;
    };
    if count == 1 && known().count() > 1 {
        return PixelDepth {
            class: Class::Differs,
            ..PixelDepth::NONE
        };
    }
    let (mut weight, mut inverse, mut normal) = (0.0, 0.0, Vector3::zeros());
    let mut edge = false;
    for plane in known().filter(|plane| agree(best, plane)) {
        let share = 1.0 / (plane.sigma * plane.sigma);
        weight += share;
        inverse += share * plane.inverse;
        normal += plane.normal * share;
        edge |= plane.edge;
    }
    let class = if edge {
        Class::Edge
    } else if count > 1 {
        Class::Confirmed
    } else {
        Class::Pair
    };
    PixelDepth {
        inverse: inverse / weight,
        sigma: 1.0 / weight.sqrt(),
        normal: normal / weight,
        class,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(inverse: f32, sigma: f32) -> Option<Plane> {
        Some(Plane {
            normal: Vector3::new(0.0, 0.0, inverse),
            inverse,
            sigma,
            edge: false,
        })
    }

    fn decided(planes: &[Option<Plane>]) -> PixelDepth {
        let mut all = [None; MOST_PAIRS];
        all[..planes.len()].copy_from_slice(planes);
        decide(&all)
    }

    #[test]
    fn two_pairs_that_agree_confirm_and_two_that_differ_give_nothing() {
        let agreed = decided(&[plane(0.100, 0.002), None, plane(0.103, 0.001)]);
        assert_eq!(agreed.class, Class::Confirmed);
        // Weights 1 and 4: 0.1024, and 1 / sqrt(1 / 0.002^2 + 1 / 0.001^2).
        assert!((agreed.inverse - 0.1024).abs() < 1e-6, "{}", agreed.inverse);
        assert!((agreed.sigma - 0.000_894).abs() < 1e-6, "{}", agreed.sigma);
        let differing = decided(&[plane(0.1, 0.001), plane(0.2, 0.001)]);
        assert!(differing.class == Class::Differs && differing.inverse == 0.0);
        let two_of_three = decided(&[plane(0.2, 0.0001), plane(0.1, 0.001), plane(0.1, 0.001)]);
        assert_eq!(two_of_three.class, Class::Confirmed);
        assert!(
            (two_of_three.inverse - 0.1).abs() < 1e-6,
            "{}",
            two_of_three.inverse
        );
        assert_eq!(decided(&[plane(0.1, 0.001)]).class, Class::Pair);
        assert_eq!(decided(&[]).class, Class::None);
    }
}
