//! x2ᵀ M x1 = 0 for M essential or fundamental: errors, refinement, the poses behind it.

use marf_scene::Pose;
use nalgebra::{Matrix3, SVector, Vector2, Vector3};

use super::levenberg_marquardt::{NormalEquations, minimise};
use super::rotation::{cross_matrix, exp_so3};
use super::svd::svd3;

/// The positions of one point in two photos.
pub type PointPair = [Vector2<f64>; 2];

/// The matrix that is refined, which decides what may vary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum EpipolarModel {
    /// Two equal singular values and a zero: five degrees of freedom.
    Essential,
    /// Rank two: seven degrees of freedom.
    Fundamental,
}

/// Returns the squared Sampson distance, first order in the noise (Hartley and Zisserman 2004, eq. 11.9).
///
/// `noise2`: squared sigma of one unit of error in photo 1 and 2, in the points' unit ((1 / focal)² in
/// plane units gives an answer in pixels²). Infinite where both points are epipoles.
#[inline]
pub fn sampson2(matrix: &Matrix3<f64>, [p, q]: &PointPair, noise2: [f64; 2]) -> f64 {
    let (p, q) = (p.push(1.0), q.push(1.0));
    let (line_2, line_1) = (matrix * p, matrix.tr_mul(&q));
    let spread = noise2[1] * line_2.xy().norm_squared() + noise2[0] * line_1.xy().norm_squared();
    let numerator = q.dot(&line_2);
    if spread > 0.0 {
        numerator * numerator / spread
    } else {
        f64::INFINITY
    }
}

/// M = U diag(1, s, 0) Vᵀ.
#[derive(Clone)]
struct Factors {
    u: Matrix3<f64>,
    v: Matrix3<f64>,
    s: f64,
}

impl Factors {
    /// Returns M.
    fn matrix(&self) -> Matrix3<f64> {
        let (u, v) = (&self.u, &self.v);
        u.column(0) * v.column(0).transpose() + u.column(1) * v.column(1).transpose() * self.s
    }
}

impl EpipolarModel {
    /// Returns the matrix of this kind near M with the smallest Cauchy sum of Sampson errors. `scale` is in units of
    /// sigma (pixels). At most `steps` damped steps. `None` if M or its cost is not finite.
    pub(crate) fn refined<'a>(
        self,
        matrix: &Matrix3<f64>,
        pairs: impl Iterator<Item = &'a PointPair> + Clone,
        noise2: [f64; 2],
        scale: f64,
        steps: usize,
    ) -> Option<Matrix3<f64>> {
        let svd = svd3(matrix);
        let s = if self == Self::Essential {
            1.0
        } else {
            svd.s.y / svd.s.x
        };
        let start = Factors {
            u: svd.u,
            v: svd.v,
            s,
        };
        let linearise = |factors: &Factors| {
            let matrix = factors.matrix();
            let mut normal = NormalEquations::<7>::zero();
            for pair in pairs.clone() {
                if let Some((residual, slope)) = sampson_residual(factors, &matrix, pair, noise2, self) {
                    normal.add(residual, &slope, scale * scale);
                }
            }
            Some(normal)
        };
        let moved = |factors: &Factors, step: &SVector<f64, 7>| Factors {
            u: factors.u * exp_so3(&step.fixed_rows::<3>(0).into_owned()),
            v: factors.v * exp_so3(&step.fixed_rows::<3>(3).into_owned()),
            s: factors.s + step[6],
        };
        let refined = minimise(&start, steps, linearise, moved)?.matrix();
        refined.iter().all(|value| value.is_finite()).then_some(refined)
    }
}

/// Returns the Sampson residual and its derivatives by rotations of U (3), of V (3) and by s. For an essential matrix
/// the rotation of V about z repeats that of U and s is fixed, so both derivatives are 0.
fn sampson_residual(
    factors: &Factors,
    matrix: &Matrix3<f64>,
    [p, q]: &PointPair,
    noise2: [f64; 2],
    model: EpipolarModel,
) -> Option<(f64, SVector<f64, 7>)> {
    let (p, q) = (p.push(1.0), q.push(1.0));
    let flat = |line: Vector3<f64>| Vector3::new(line.x, line.y, 0.0);
    let (line_2, line_1) = (matrix * p, flat(matrix.tr_mul(&q)));
    let spread = noise2[1] * line_2.xy().norm_squared() + noise2[0] * line_1.norm_squared();
    if spread <= 0.0 {
        return None;
    }
    let root = spread.sqrt();
    let numerator = q.dot(&line_2);
    let kappa = numerator / spread;
    // dr/dM in the bases of U and V: (q - k n2 l2) pᵀ - k n1 q l1ᵀ, over the root of the spread.
    let left = factors.u.tr_mul(&(q - flat(line_2) * (kappa * noise2[1]))) / root;
    let right = factors.u.tr_mul(&q) * (kappa * noise2[0] / root);
    let a = left * factors.v.tr_mul(&p).transpose() - right * factors.v.tr_mul(&line_1).transpose();
    let s = factors.s;
    let twist = if model == EpipolarModel::Fundamental {
        1.0
    } else {
        0.0
    };
    let slope = SVector::from([
        s * a[(2, 1)],
        -a[(2, 0)],
        a[(1, 0)] - s * a[(0, 1)],
        s * a[(1, 2)],
        -a[(0, 2)],
        twist * (a[(0, 1)] - s * a[(1, 0)]),
        twist * a[(1, 1)],
    ]);
    Some((numerator / root, slope))
}

/// Returns the essential matrix of a relative pose, [t]x R.
#[inline]
pub fn essential_of(cam2_from_cam1: &Pose) -> Matrix3<f64> {
    cross_matrix(&cam2_from_cam1.translation) * cam2_from_cam1.rotation
}

/// Decomposes E into four poses (unit translation) and returns the one with most points in front of both cameras, the
/// first on ties, with their number.
pub(crate) fn pose_of_essential<'a>(
    essential: &Matrix3<f64>,
    pairs: impl Iterator<Item = &'a PointPair> + Clone,
) -> (Pose, usize) {
    let svd = svd3(essential);
    let quarter = exp_so3(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
    let along = svd.u.column(2).into_owned();
    let mut best = (Pose::identity(), 0);
    for (i, turn) in [quarter, quarter.transpose()].into_iter().enumerate() {
        let rotation = svd.u * turn * svd.v.transpose();
        for (j, translation) in [along, -along].into_iter().enumerate() {
            let pose = Pose {
                rotation,
                translation,
            };
            let front = pairs.clone().filter(|pair| in_front(&pose, pair)).count();
            if front > best.1 || (i, j) == (0, 0) {
                best = (pose, front);
            }
        }
    }
    best
}

/// Returns the depths (z1, z2) at which the two rays of a pair come closest, in units of the baseline. Infinite or
/// NaN for parallel rays.
pub(crate) fn depths(cam2_from_cam1: &Pose, [p, q]: &PointPair) -> (f64, f64) {
    let (ray_1, ray_2) = (cam2_from_cam1.rotation * p.push(1.0), q.push(1.0));
    let normal = ray_1.cross(&ray_2);
    let area = normal.norm_squared();
    let t = cam2_from_cam1.translation;
    (
        t.cross(&ray_2).dot(&-normal) / area,
        t.cross(&ray_1).dot(&-normal) / area,
    )
}

/// Whether a point is in front of both cameras.
fn in_front(cam2_from_cam1: &Pose, pair: &PointPair) -> bool {
    let (depth_1, depth_2) = depths(cam2_from_cam1, pair);
    depth_1 > 0.0 && depth_2 > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::scenes::{Scene, pose};

    #[test]
    fn depths_of_a_hand_worked_pair() {
        // A point at (0, 0, 4), with camera 2 shifted by 1 to the right.
        let pose = Pose {
            translation: -Vector3::x(),
            ..Pose::identity()
        };
        let (z1, z2) = depths(&pose, &[Vector2::zeros(), Vector2::new(-0.25, 0.0)]);
        assert!((z1 - 4.0).abs() < 1e-14 && (z2 - 4.0).abs() < 1e-14, "{z1} {z2}");
    }

    #[test]
    fn slopes_agree_with_central_differences() {
        let truth = pose([0.1, -0.2, 0.05], [1.0, 0.3, -0.2]);
        let scene = Scene::new(5, 20, &truth, 0.01);
        let noise2 = [1e-6, 2.5e-6];
        let svd =
            svd3(&(essential_of(&truth) + Matrix3::new(0.0, 0.01, 0.0, 0.02, 0.0, 0.0, 0.0, 0.01, 0.0)));
        let factors = Factors {
            u: svd.u,
            v: svd.v,
            s: svd.s.y / svd.s.x,
        };
        let residual = |at: &Factors, pair: &PointPair| {
            sampson_residual(at, &at.matrix(), pair, noise2, EpipolarModel::Fundamental)
                .unwrap()
                .0
        };
        for pair in &scene.pairs {
            let (_, slope) = sampson_residual(
                &factors,
                &factors.matrix(),
                pair,
                noise2,
                EpipolarModel::Fundamental,
            )
            .unwrap();
            for k in 0..7 {
                let at = |h: f64| {
                    let turn = |first: usize| Vector3::from_fn(|i, _| if first + i == k { h } else { 0.0 });
                    let (u, v) = (factors.u * exp_so3(&turn(0)), factors.v * exp_so3(&turn(3)));
                    let s = factors.s + if k == 6 { h } else { 0.0 };
                    residual(&Factors { u, v, s }, pair)
                };
                let central = (at(1e-6) - at(-1e-6)) / 2e-6;
                let scale = slope.amax();
                assert!(
                    (central - slope[k]).abs() < 1e-6 * scale,
                    "{k}: {central} {}",
                    slope[k]
                );
            }
        }
    }

    #[test]
    fn polish_reaches_the_truth_from_five_percent_away() {
        let truth = pose([0.1, -0.2, 0.05], [1.0, 0.3, -0.2]);
        let scene = Scene::new(6, 60, &truth, 0.0);
        let start = essential_of(&truth) + Matrix3::from_fn(|i, j| 0.03 * (i as f64 - j as f64 * 0.7));
        for family in [EpipolarModel::Essential, EpipolarModel::Fundamental] {
            let got = family
                .refined(&start, scene.pairs.iter(), [1e-6; 2], 4.0, 50)
                .unwrap();
            let worst = scene
                .pairs
                .iter()
                .map(|pair| sampson2(&got, pair, [1e-6; 2]))
                .fold(0.0, f64::max);
            assert!(worst.sqrt() < 1e-6, "{family:?}: {worst:e}");
        }
    }

    #[test]
    fn the_pose_behind_an_essential_matrix_is_the_one_with_points_in_front() {
        for t in [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.2, -1.0, 0.4]] {
            let truth = pose([0.2, 0.1, -0.3], t);
            let scene = Scene::new(7, 30, &truth, 0.0);
            let (got, front) = pose_of_essential(&(essential_of(&truth) * -3.0), scene.pairs.iter());
            assert_eq!(front, 30, "{t:?}");
            assert!((got.rotation - truth.rotation).norm() < 1e-12, "{t:?}");
            assert!(
                (got.translation - truth.translation.normalize()).norm() < 1e-12,
                "{t:?}"
            );
        }
    }
}
