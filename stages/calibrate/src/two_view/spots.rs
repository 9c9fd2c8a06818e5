//! Matches as pairs of distinct, finite, undistorted points.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2};

use super::ViewPoints;
use crate::estimators::Pair;

/// The usable matches of a pair, in the order given.
pub(super) struct Spots {
    pub matches: Vec<[u32; 2]>,
    /// As measured, pixels.
    pub pixels: Vec<Pair>,
    /// Undistorted, at z = 1.
    pub planes: Vec<Pair>,
}

impl Spots {
    /// Keeps the first of each group of matches between the same two pixels; drops those that name no
    /// feature, are not finite or lie where a lens has no ray.
    pub(super) fn new(a: &ViewPoints, b: &ViewPoints, matches: &[[u32; 2]]) -> Self {
        let seen: Vec<(usize, Pair)> = matches
            .iter()
            .enumerate()
            .filter_map(|(i, m)| Some((i, measured(a, b, m)?)))
            .collect();
        let bits = |(_, [p, q]): &(usize, Pair)| [p.x, p.y, q.x, q.y].map(f64::to_bits);
        let mut distinct = seen;
        distinct.sort_by_key(|spot| (bits(spot), spot.0));
        distinct.dedup_by_key(|spot| bits(spot));
        distinct.sort_by_key(|spot| spot.0);
        let mut spots = Self {
            matches: Vec::new(),
            pixels: Vec::new(),
            planes: Vec::new(),
        };
        for (i, pixels) in distinct {
            if let (Some(p), Some(q)) = (a.camera.unproject(&pixels[0]), b.camera.unproject(&pixels[1])) {
                spots.matches.push(matches[i]);
                spots.pixels.push(pixels);
                spots.planes.push([p.xy(), q.xy()]);
            }
        }
        spots
    }

    pub(super) fn subset(&self, indices: &[usize]) -> Self {
        Self {
            matches: indices.iter().map(|&i| self.matches[i]).collect(),
            pixels: indices.iter().map(|&i| self.pixels[i]).collect(),
            planes: indices.iter().map(|&i| self.planes[i]).collect(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.matches.len()
    }
}

fn measured(a: &ViewPoints, b: &ViewPoints, [i, j]: &[u32; 2]) -> Option<Pair> {
    let pair = [*a.pixels.get(*i as usize)?, *b.pixels.get(*j as usize)?];
    pair.iter()
        .flat_map(|pixel| pixel.iter())
        .all(|value| value.is_finite())
        .then_some(pair)
}

/// K of the ideal pinhole.
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

/// One focal length for both axes.
pub(super) fn focal_px(camera: &Camera) -> f64 {
    0.5 * (camera.fx_px + camera.fy_px)
}

/// Carries pixels to coordinates of about 1: the photo's centre to 0, `unit` pixels to 1.
pub(super) fn centring(camera: &Camera, unit: f64) -> Matrix3<f64> {
    let middle = Vector2::new(f64::from(camera.width), f64::from(camera.height)) * 0.5;
    Matrix3::new(1.0, 0.0, -middle.x, 0.0, 1.0, -middle.y, 0.0, 0.0, unit) / unit
}
