//! Vignetting of cameras from the tones of the points that their photos share.
//!
//! A photo shows v(r) * gain * colour. Of two photos of a point, the logarithm of the ratio of the tones is that of their gains, the same for
//! all their common points, and that of v at two distances from the principal point. Without its mean over each two photos, v is left.
//! It is fitted by reweighted least squares. Each group of photos is held back once: how the curves of the others differ gives the standard
//! deviation (jackknife), and the photos held back confirm them.

use libm::log;
use marf_numeric::upper_median;
use marf_scene::{Camera, Falloff};
use nalgebra::{Matrix3, Vector3, Vector4};

use crate::tones::{LEAST_COMMON, PointTone, ROUNDS, SIGMA_PER_MEDIAN, pairs, trusted};

/// Groups of photos that are held back in turn.
const GROUPS: usize = 8;
/// Fewest photos of a camera: each is a group of its own then.
const LEAST_PHOTOS: usize = 4;

/// The points that two photos of a camera share.
struct CommonPoints {
    /// Groups of the photos.
    groups: [usize; 2],
    points: Vec<CommonPoint>,
}

struct CommonPoint {
    log_ratio: f64,
    /// r² in each photo, where that of the farthest corner is 1.
    radius2: [f64; 2],
}

/// Returns what points say of the vignetting of each camera of 4 photos or more. Cameras whose photos share too few points, or
/// all of them at one distance from the principal point, are left out.
///
/// - `cameras`: those of the photos.
/// - `points`: for each point its tones in these photos.
pub fn find_vignetting(cameras: &[Camera], points: &[Vec<PointTone>]) -> Vec<Falloff> {
    let pairs = pairs(points.iter().map(Vec::as_slice));
    let mut found: Vec<Falloff> = Vec::new();
    for (first, camera) in cameras.iter().enumerate() {
        let photos: Vec<usize> = (first..cameras.len())
            .filter(|photo| cameras[*photo] == *camera)
            .collect();
        if photos.len() < LEAST_PHOTOS || cameras[..first].contains(camera) {
            continue;
        }
        let groups = GROUPS.min(photos.len());
        let group = |photo: &usize| photos.binary_search(photo).ok().map(|rank| rank % groups);
        let common = pairs.iter().filter_map(|([low, high], common)| {
            let groups = [group(low)?, group(high)?];
            (common.len() >= LEAST_COMMON).then(|| CommonPoints::new(groups, common, camera.corner_radius2()))
        });
        found.extend(falloff(*camera, groups, &common.collect::<Vec<_>>()));
    }
    found
}

impl CommonPoints {
    fn new(groups: [usize; 2], common: &[[PointTone; 2]], corner: f64) -> Self {
        let point = |both: &[PointTone; 2]| {
            let [low, high] = both.map(|seen| log(seen.tone.iter().sum()));
            CommonPoint {
                log_ratio: high - low,
                radius2: both.map(|seen| seen.radius2 / corner),
            }
        };
        Self {
            groups,
            points: common.iter().map(point).collect(),
        }
    }

    /// Returns how far from their median the points are that a curve leaves.
    fn differences(&self, factors: &Vector3<f64>) -> Vec<f64> {
        let left = self.points.iter().map(|point| point.slopes_and_rest(factors).w);
        let left: Vec<f64> = left.collect();
        let median = upper_median(left.iter().copied()).unwrap_or_default();
        left.into_iter().map(|rest| (rest - median).abs()).collect()
    }
}

impl CommonPoint {
    /// Returns the slopes of the logarithm of v's ratio in the factors, and what it leaves of the tones' ratio.
    fn slopes_and_rest(&self, factors: &Vector3<f64>) -> Vector4<f64> {
        let [low, high] = self.radius2.map(|r2| {
            let powers = Vector3::new(r2, r2 * r2, r2 * r2 * r2);
            let v = (1.0 + factors.dot(&powers)).max(Falloff::LEAST);
            (powers / v).push(-log(v))
        });
        (high - low) + Vector4::w() * self.log_ratio
    }
}

fn falloff(camera: Camera, groups: usize, common: &[CommonPoints]) -> Option<Falloff> {
    let factors = curve(common.iter())?;
    let others = |group: usize| curve(common.iter().filter(move |two| !two.groups.contains(&group)));
    let others: Vec<Vector3<f64>> = (0..groups).map(others).collect::<Option<_>>()?;
    let darkening = |factors: &Vector3<f64>| -factors.sum();
    let mean = others.iter().map(darkening).sum::<f64>() / groups as f64;
    let squares = others
        .iter()
        .map(|factors| (darkening(factors) - mean).powi(2))
        .sum::<f64>();
    let held_back = |factors: &dyn Fn(usize) -> Vector3<f64>| {
        let judged = common
            .iter()
            .flat_map(|two| two.groups.map(|group| two.differences(&factors(group))));
        Some(SIGMA_PER_MEDIAN * upper_median(judged.flatten())?)
    };
    let corner = camera.corner_radius2();
    Some(Falloff {
        camera,
        factors: [0, 1, 2].map(|power| factors[power] / corner.powi(power as i32 + 1)),
        darkening: darkening(&factors),
        sigma: (squares * (groups - 1) as f64 / groups as f64).sqrt(),
        pairs: common.iter().map(|two| two.points.len() as u64).sum(),
        spread: held_back(&|_| Vector3::zeros())?,
        noise: held_back(&|group| others[group])?,
    })
}

/// Returns the factors of r², r⁴ and r⁶ by which v fits the points best. `None` if they do not decide them.
fn curve<'a>(common: impl Iterator<Item = &'a CommonPoints> + Clone) -> Option<Vector3<f64>> {
    let count = common.clone().map(|two| two.points.len()).sum();
    let mut trust = vec![1.0; count];
    let mut factors = Vector3::zeros();
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let mut residuals = Vec::with_capacity(count);
        for two in common.clone() {
            let lines: Vec<Vector4<f64>> = two
                .points
                .iter()
                .map(|point| point.slopes_and_rest(&factors))
                .collect();
            let weights = &trust[residuals.len()..][..lines.len()];
            let weighted: Vector4<f64> = lines
                .iter()
                .zip(weights)
                .map(|(line, weight)| line * *weight)
                .sum();
            let mean = weighted / weights.iter().sum::<f64>();
            for (line, weight) in lines.iter().zip(weights) {
                let line = line - mean;
                normal += line.xyz() * line.xyz().transpose() * *weight;
                right += line.xyz() * (line.w * weight);
                residuals.push(line.w.abs());
            }
        }
        factors += normal.cholesky()?.solve(&right);
        trust = trusted(residuals);
    }
    let v = |r2: f64| 1.0 + r2 * (factors.x + r2 * (factors.y + r2 * factors.z));
    (0..=16)
        .all(|place| v(f64::from(place) / 16.0) > Falloff::LEAST)
        .then_some(factors)
}

#[cfg(test)]
mod tests;
