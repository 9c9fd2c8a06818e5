//! Matches as distinct, finite, undistorted correspondences.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2};

use super::types::ViewPoints;
use crate::estimators::PointPair;

/// The usable matches of a pair of photos, in the given order.
pub(super) struct Correspondences<'a> {
    pub cameras: [&'a Camera; 2],
    pub matches: Vec<[u32; 2]>,
    /// As observed, pixels.
    pub pixels: Vec<PointPair>,
    /// Undistorted, at z = 1.
    pub planes: Vec<PointPair>,
}

impl<'a> Correspondences<'a> {
    /// Returns the first of each group of matches between the same two positions, without those that name no feature, are
    /// not finite or have no ray.
    pub(super) fn new(views: [&ViewPoints<'a>; 2], matches: &[[u32; 2]]) -> Self {
        let usable: Vec<(usize, PointPair)> = matches
            .iter()
            .enumerate()
            .filter_map(|(i, m)| Some((i, measured(views, m)?)))
            .collect();
        let bits = |(_, [p, q]): &(usize, PointPair)| [p.x, p.y, q.x, q.y].map(f64::to_bits);
        let mut distinct = usable;
        distinct.sort_by_key(|one| (bits(one), one.0));
        distinct.dedup_by_key(|one| bits(one));
        distinct.sort_by_key(|one| one.0);
        let cameras = views.map(|view| view.camera);
        let mut correspondences = Self {
            cameras,
            matches: Vec::new(),
            pixels: Vec::new(),
            planes: Vec::new(),
        };
        for (i, pixels) in distinct {
            if let (Some(p), Some(q)) = (cameras[0].unproject(&pixels[0]), cameras[1].unproject(&pixels[1])) {
                correspondences.matches.push(matches[i]);
                correspondences.pixels.push(pixels);
                correspondences.planes.push([p.xy(), q.xy()]);
            }
        }
        correspondences
    }

    /// Returns the correspondences of some indices.
    pub(super) fn subset(&self, indices: &[usize]) -> Self {
        Self {
            cameras: self.cameras,
            matches: indices.iter().map(|&i| self.matches[i]).collect(),
            pixels: indices.iter().map(|&i| self.pixels[i]).collect(),
            planes: indices.iter().map(|&i| self.planes[i]).collect(),
        }
    }

    /// Returns the number of correspondences.
    pub(super) fn len(&self) -> usize {
        self.matches.len()
    }
}

/// Returns the observed positions of a match.
fn measured([a, b]: [&ViewPoints<'_>; 2], [i, j]: &[u32; 2]) -> Option<PointPair> {
    let pair = [*a.pixels.get(*i as usize)?, *b.pixels.get(*j as usize)?];
    pair.iter()
        .flat_map(|pixel| pixel.iter())
        .all(|value| value.is_finite())
        .then_some(pair)
}

/// Returns the intrinsic matrix K of a camera without its distortion.
pub(super) fn intrinsics(camera: &Camera) -> Matrix3<f64> {
    Matrix3::new(
        camera.fx_px,
        0.0,
        camera.cx_px,
        0.0,
        camera.fy_px,
        camera.cy_px,
        0.0,
        0.0,
        1.0,
    )
}

/// Returns the mean focal length of both axes.
pub(super) fn focal_px(camera: &Camera) -> f64 {
    0.5 * (camera.fx_px + camera.fy_px)
}

/// Returns the transform of pixels to coordinates of about 1: the photo's centre to 0, `unit` pixels to 1.
pub(super) fn centring(camera: &Camera, unit: f64) -> Matrix3<f64> {
    let middle = Vector2::new(f64::from(camera.width), f64::from(camera.height)) * 0.5;
    Matrix3::new(1.0, 0.0, -middle.x, 0.0, 1.0, -middle.y, 0.0, 0.0, unit) / unit
}
