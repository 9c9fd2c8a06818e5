//! Maps without parallax that a wrong focal length or a cut picture turns into a plane passed by a camera.

use marf_scene::Camera;
use nalgebra::{Matrix3, Vector2};

use super::focal::{RANGE, golden};
use super::relate::Matches;
use super::spots::focal_px;
use crate::estimators::{transfer2, turn_between};

/// Steps of the log grid of focal lengths: 14 % each.
const STEPS: usize = 24;
/// Matches that are asked at most: four unknowns need no more.
const MOST: usize = 200;

/// q = scale p + shift: one picture, cropped or zoomed.
pub(super) struct SamePicture {
    scale: f64,
    shift: Vector2<f64>,
}

/// A turn, with coordinates taken for a focal length `factor` times as long.
pub(super) struct OtherFocal {
    factor: f64,
    pub turn: Matrix3<f64>,
}

/// Fits scale and shift by least squares; `None` where they mirror or the points are one.
pub(super) fn same_picture(matches: &Matches<'_>, on: &[usize]) -> Option<SamePicture> {
    let count = on.len() as f64;
    let mean = |side: usize| on.iter().map(|&i| matches.pairs[i][side]).sum::<Vector2<f64>>() / count;
    let middles = [mean(0), mean(1)];
    let (along, square) = on.iter().fold((0.0, 0.0), |(along, square), &i| {
        let [p, q] = matches.pairs[i];
        let (p, q) = (p - middles[0], q - middles[1]);
        (along + p.dot(&q), square + p.norm_squared())
    });
    let scale = along / square;
    (scale.is_finite() && scale > 0.0).then(|| SamePicture {
        scale,
        shift: middles[1] - scale * middles[0],
    })
}

impl SamePicture {
    /// Squared distance in photo 2 per unit of its variance, in units of the limit.
    pub(super) fn error2(&self, matches: &Matches<'_>, i: usize) -> f64 {
        let [p, q] = &matches.pairs[i];
        let spread = matches.noise2[1] + self.scale * self.scale * matches.noise2[0];
        (q - self.scale * p - self.shift).norm_squared() / (spread * matches.limit * matches.limit)
    }
}

/// Finds the focal length, within [0.2, 5] x the longer side, under which a turn explains the matches best.
pub(super) fn other_focal(matches: &Matches<'_>, on: &[usize], camera: &Camera) -> Option<OtherFocal> {
    let on: Vec<usize> = on.iter().copied().step_by(on.len() / MOST + 1).collect();
    let ray = |i: usize, side: usize, factor: f64| matches.pairs[i][side].push(factor).normalize();
    let turn = |log_factor: f64| {
        let factor = libm::exp(log_factor);
        OtherFocal {
            factor,
            turn: turn_between(on.iter().map(|&i| (ray(i, 0, factor), ray(i, 1, factor), 1.0))),
        }
    };
    let loss = |log_factor: f64| {
        let map = turn(log_factor);
        on.iter().map(|&i| map.error2(matches, i).min(1.0)).sum::<f64>()
    };
    let side = f64::from(camera.width.max(camera.height));
    let [low, high] = RANGE.map(|share| libm::log(share * side / focal_px(camera)));
    let at = |step: usize| low + (high - low) * step as f64 / STEPS as f64;
    let best = (0..=STEPS).min_by(|&i, &j| loss(at(i)).total_cmp(&loss(at(j))))?;
    let around = [at(best.saturating_sub(1)), at((best + 1).min(STEPS))];
    Some(turn(golden(&loss, around[0], around[1])))
}

impl OtherFocal {
    /// Squared distance in photo 2 per unit of its variance, in units of the limit; infinite behind the camera.
    pub(super) fn error2(&self, matches: &Matches<'_>, i: usize) -> f64 {
        let [p, q] = matches.pairs[i].map(|point| point / self.factor);
        if (self.turn * p.push(1.0)).z <= 0.0 {
            return f64::INFINITY;
        }
        let spread = matches.noise2[0] + matches.noise2[1];
        let distance2 = transfer2(&self.turn, &p, &q) * self.factor * self.factor;
        distance2 / (spread * matches.limit * matches.limit)
    }
}
