//! Self-calibration: the focal length on which the fundamental matrices of many pairs agree.

use marf_scene::Camera;
use nalgebra::Matrix3;

use super::correspondences::focal_px;

/// Focal lengths tried, in units of the photo's longer side.
pub(super) const RANGE: [f64; 2] = [0.2, 5.0];

/// Steps of the log grid: 2.7 % each.
const STEPS: usize = 120;

/// Golden sections that shrink two grid steps below 1e-5.
const SECTIONS: usize = 20;

/// (s1 - s2) / (s1 + s2) at which the weight of a pair is halved: F from matches with errors of a pixel leaves a few
/// hundredths.
const SCALE: f64 = 0.02;

/// Number of inliers above which the weight of a pair no longer grows.
const MOST_INLIERS: usize = 200;

/// The minimum must lie this far (in the mean Cauchy loss) below both values at `ASIDE` times it.
const DEPTH: f64 = 0.1;
const ASIDE: f64 = 1.35;

/// This share of the weight must lie within twice `SCALE` at the minimum: each plane's matrix is essential
/// somewhere too, but no two at the same focal length.
const AGREED: f64 = 0.5;

/// Returns the focal length, in pixels, for which the fundamental matrices of many pairs of one camera are closest to
/// essential matrices.
///
/// An essential matrix has two equal singular values (Mendonca and Cipolla, CVPR 1999). Their relative difference,
/// under Cauchy's loss and weighed by inliers, is minimised over [0.2, 5] x the longer side, with the principal point
/// at the camera's and fx : fy kept. `None` without a usable pair, or with the minimum at an end of the range. Also
/// `None` where the minimum is shallow (parallel axes: every focal length is as good) or shared by less than half of
/// the pairs (planes). Pure rotations do determine it.
pub fn focal_from_pairs(pairs: &[(Matrix3<f64>, usize)], camera: &Camera) -> Option<f64> {
    let side = f64::from(camera.width.max(camera.height));
    let usable: Vec<(Matrix3<f64>, f64)> = pairs
        .iter()
        .filter_map(|(f, inliers)| Some((centred(f, camera, side)?, weight(*inliers))))
        .collect();
    let total: f64 = usable.iter().map(|(_, weight)| weight).sum();
    if usable.is_empty() || total <= 0.0 {
        return None;
    }
    let loss = |log_focal: f64| {
        let focal = libm::exp(log_focal);
        let terms = usable.iter().map(|(f, weight)| {
            let imbalance = imbalance(f, focal) / SCALE;
            weight * libm::log1p(imbalance * imbalance)
        });
        terms.sum::<f64>() / total
    };
    let [low, high] = RANGE.map(libm::log);
    let at = |step: usize| low + (high - low) * step as f64 / STEPS as f64;
    let losses: Vec<f64> = (0..=STEPS).map(|step| loss(at(step))).collect();
    let best = (0..=STEPS).min_by(|&i, &j| losses[i].total_cmp(&losses[j]))?;
    if best == 0 || best == STEPS {
        return None;
    }
    let log_focal = golden_section(&loss, at(best - 1), at(best + 1));
    let aside = libm::log(ASIDE);
    let rise = loss(log_focal - aside).min(loss(log_focal + aside)) - loss(log_focal);
    let focal = libm::exp(log_focal);
    let near = usable.iter().filter(|(f, _)| imbalance(f, focal) <= 2.0 * SCALE);
    let agreed: f64 = near.map(|(_, weight)| weight).sum();
    (rise >= DEPTH && agreed >= AGREED * total).then_some(focal * side)
}

/// Returns the weight of a pair.
fn weight(inliers: usize) -> f64 {
    inliers.min(MOST_INLIERS) as f64
}

/// Returns F between coordinates with the principal point at 0, in units of the longer side, with square pixels.
fn centred(fundamental: &Matrix3<f64>, camera: &Camera, side: f64) -> Option<Matrix3<f64>> {
    let mean = focal_px(camera);
    let (x, y) = (camera.fx_px / mean * side, camera.fy_px / mean * side);
    let pixels = Matrix3::new(x, 0.0, camera.cx_px, 0.0, y, camera.cy_px, 0.0, 0.0, 1.0);
    let carried = pixels.transpose() * fundamental * pixels;
    let unit = carried / carried.norm();
    unit.iter().all(|value| value.is_finite()).then_some(unit)
}

/// Returns (s1 - s2) / (s1 + s2) of diag(f, f, 1) F diag(f, f, 1). For a rank-two matrix s1² + s2² is its squared
/// norm and s1 s2 that of its cofactors.
fn imbalance(fundamental: &Matrix3<f64>, focal: f64) -> f64 {
    let k = nalgebra::Vector3::new(focal, focal, 1.0);
    let e = fundamental.component_mul(&(k * k.transpose()));
    let row = |i: usize| e.row(i).transpose();
    let cofactors = [
        row(1).cross(&row(2)),
        row(2).cross(&row(0)),
        row(0).cross(&row(1)),
    ];
    let product = cofactors.iter().map(|c| c.norm_squared()).sum::<f64>().sqrt();
    let squares = e.norm_squared();
    ((squares - 2.0 * product).max(0.0) / (squares + 2.0 * product)).sqrt()
}

/// Returns the minimum of a unimodal function between two bounds, by golden section search.
pub(super) fn golden_section(loss: &impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    const SHARE: f64 = 0.618_033_988_749_894_9;
    for _ in 0..SECTIONS {
        let (left, right) = (high - SHARE * (high - low), low + SHARE * (high - low));
        if loss(left) <= loss(right) {
            high = right;
        } else {
            low = left;
        }
    }
    0.5 * (low + high)
}
