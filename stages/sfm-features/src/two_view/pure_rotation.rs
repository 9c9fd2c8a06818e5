//! Mappings without parallax that, with a wrong focal length or a cropped image, resemble a camera moving past a plane.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2};

use super::correspondences::focal_px;
use super::focal::{RANGE, golden_section};
use super::ray_matches::RayMatches;
use crate::estimators::{rotation_between, transfer2};

/// Steps of the log grid of focal lengths: 14 % each.
const STEPS: usize = 24;
/// Largest number of matches used: four unknowns need no more.
const MOST: usize = 200;

/// q = scale p + shift: one image, cropped or zoomed.
pub(super) struct ScaleAndShift {
    scale: f64,
    shift: Vector2<f64>,
}

/// A rotation, with coordinates for a focal length `factor` times as long.
pub(super) struct RotationAndFocal {
    factor: f64,
    pub rotation: Matrix3<f64>,
}

/// Returns scale and shift by least squares. `None` if the scale is not positive or all points are equal.
pub(super) fn fit_scale_and_shift(matches: &RayMatches<'_>, on: &[usize]) -> Option<ScaleAndShift> {
    let count = on.len() as f64;
    let mean = |side: usize| on.iter().map(|&i| matches.pairs[i][side]).sum::<Vector2<f64>>() / count;
    let middles = [mean(0), mean(1)];
    let (along, square) = on.iter().fold((0.0, 0.0), |(along, square), &i| {
        let [p, q] = matches.pairs[i];
        let (p, q) = (p - middles[0], q - middles[1]);
        (along + p.dot(&q), square + p.norm_squared())
    });
    let scale = along / square;
    (scale.is_finite() && scale > 0.0).then(|| ScaleAndShift {
        scale,
        shift: middles[1] - scale * middles[0],
    })
}

impl ScaleAndShift {
    /// Returns the squared error in photo 2 over its variance, in units of the limit.
    pub(super) fn error2(&self, matches: &RayMatches<'_>, i: usize) -> f64 {
        let [p, q] = &matches.pairs[i];
        let spread = matches.noise2[1] + self.scale * self.scale * matches.noise2[0];
        (q - self.scale * p - self.shift).norm_squared() / (spread * matches.limit * matches.limit)
    }
}

/// Returns the focal length, within [0.2, 5] x the longer side, for which a rotation explains the matches best, and that
/// rotation.
pub(super) fn fit_rotation_and_focal(
    matches: &RayMatches<'_>,
    on: &[usize],
    camera: &Camera,
) -> Option<RotationAndFocal> {
    let on: Vec<usize> = on.iter().copied().step_by(on.len() / MOST + 1).collect();
    let ray = |i: usize, side: usize, factor: f64| matches.pairs[i][side].push(factor).normalize();
    let rotation = |log_factor: f64| {
        let factor = libm::exp(log_factor);
        RotationAndFocal {
            factor,
            rotation: rotation_between(on.iter().map(|&i| (ray(i, 0, factor), ray(i, 1, factor), 1.0))),
        }
    };
    let loss = |log_factor: f64| {
        let map = rotation(log_factor);
        on.iter().map(|&i| map.error2(matches, i).min(1.0)).sum::<f64>()
    };
    let side = f64::from(camera.width.max(camera.height));
    let [low, high] = RANGE.map(|share| libm::log(share * side / focal_px(camera)));
    let at = |step: usize| low + (high - low) * step as f64 / STEPS as f64;
    let best = (0..=STEPS).min_by(|&i, &j| loss(at(i)).total_cmp(&loss(at(j))))?;
    let around = [at(best.saturating_sub(1)), at((best + 1).min(STEPS))];
    Some(rotation(golden_section(&loss, around[0], around[1])))
}

impl RotationAndFocal {
    /// Returns the squared error in photo 2 over its variance, in units of the limit. Infinite behind the camera.
    pub(super) fn error2(&self, matches: &RayMatches<'_>, i: usize) -> f64 {
        let [p, q] = matches.pairs[i].map(|point| point / self.factor);
        if (self.rotation * p.push(1.0)).z <= 0.0 {
            return f64::INFINITY;
        }
        let spread = matches.noise2[0] + matches.noise2[1];
        let distance2 = transfer2(&self.rotation, &p, &q) * self.factor * self.factor;
        distance2 / (spread * matches.limit * matches.limit)
    }
}
