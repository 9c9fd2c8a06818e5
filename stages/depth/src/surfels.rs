//! The depths of a photo as points in the world.

use marf_scene::Pose;
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use crate::disparities::Class;
use crate::merge::PhotoDepth;
use crate::photos::ShrunkPhoto;

/// Least cosine between a ray and a normal: flatter views give no usable height.
const LEAST_COSINE: f64 = 0.05;

/// A point of a surface that a pixel shows, in units of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Surfel {
    pub position: Vector3<f64>,
    /// Unit normal, towards the camera.
    pub normal: Vector3<f64>,
    pub color: [u8; 3],
    /// One standard deviation along the ray.
    pub sigma: f64,
    /// One standard deviation of the surface's height at this place, if up is known.
    pub height_sigma: f64,
    pub confirmed: bool,
}

/// Returns the point of each pixel up to a distance `reach` from the camera, `[height * width]`. There is none at edges.
pub(crate) fn surfels(
    depth: &PhotoDepth,
    cam_from_world: &Pose,
    photo: &ShrunkPhoto,
    up: Option<Vector3<f64>>,
    reach: f64,
) -> Vec<Option<Surfel>> {
    let width = depth.camera.width as usize;
    let world_from_cam = cam_from_world.inverse();
    let surfel = |index: usize| {
        let confirmed = match depth.class[index] {
            Class::Confirmed => true,
            Class::Pair => false,
            Class::None | Class::Edge | Class::Differs | Class::Sky => return None,
        };
        let at = Vector2::new((index % width) as f64 + 0.5, (index / width) as f64 + 0.5);
        let ray = depth.camera.unproject(&at)?;
        let inverse = f64::from(depth.inverse[index]);
        let seen = ray / inverse;
        let distance = seen.norm();
        if distance > reach {
            return None;
        }
        // The plane's normal points away from the camera.
        let away = Vector3::from(depth.normal[index].map(f64::from)).try_normalize(1e-300)?;
        let cosine = away.dot(&ray.normalize());
        if cosine < LEAST_COSINE {
            return None;
        }
        let normal = -world_from_cam.direction(&away);
        let sigma = f64::from(depth.sigma[index]) / inverse * distance;
        // Moved along its normal, a plane rises by 1 / cos of its slope.
        let level = up.map_or(1.0, |up| up.dot(&normal).abs().max(LEAST_COSINE));
        Some(Surfel {
            position: world_from_cam.point(&seen),
            normal,
            color: photo.image.pixels[index],
            sigma,
            height_sigma: sigma * cosine / level,
            confirmed,
        })
    };
    (0..depth.inverse.len()).into_par_iter().map(surfel).collect()
}
