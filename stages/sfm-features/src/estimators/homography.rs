//! Homographies from four points and from many, and the relative poses that a homography decomposes into.

use marf_numeric::Rng;
use marf_scene::Pose;
use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use super::epipolar::PointPair;
use super::fundamental::{moved, normalisation};
use super::ransac::{Consensus, RansacOptions};
use super::rotation::nearest_rotation;
use super::svd::{matrix, smallest_eigenvector, svd3};

/// Returns H with x2 ~ H x1 for four points, unit norm. `None` if three of them are on a line in either photo.
pub(crate) fn four_point(points_1: &[Vector2<f64>; 4], points_2: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let (from, to) = (frame(points_1)?, frame(points_2)?);
    let homography = (to * from.try_inverse()?).normalize();
    homography
        .iter()
        .all(|value| value.is_finite())
        .then_some(homography)
}

/// Returns the matrix that maps the axes and (1, 1, 1) to four points.
fn frame(points: &[Vector2<f64>; 4]) -> Option<Matrix3<f64>> {
    let [a, b, c, d] = points.map(|point| point.push(1.0));
    let scales = Vector3::new(d.dot(&b.cross(&c)), d.dot(&c.cross(&a)), d.dot(&a.cross(&b)));
    // Below 1e-6 of the largest triangle three points count as collinear.
    let flat = scales.amin() <= 1e-6 * scales.amax() || !scales.amax().is_finite();
    let area = a.dot(&b.cross(&c));
    (!flat && area.abs() > 1e-6 * scales.amax())
        .then(|| Matrix3::from_columns(&[a * scales.x, b * scales.y, c * scales.z]))
}

/// Returns the homography of least squares (normalised DLT) from four or more pairs, unit norm.
pub(crate) fn fit_homography(pairs: &[PointPair]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 {
        return None;
    }
    let (to_1, to_2) = (normalisation(pairs, 0)?, normalisation(pairs, 1)?);
    let mut outer = SMatrix::<f64, 9, 9>::zeros();
    for pair in pairs {
        let (p, q) = (moved(&to_1, &pair[0]), moved(&to_2, &pair[1]));
        let (x, y, one) = (SVector::from([p.x, p.y, 1.0]), 3, 6);
        for (axis, value) in [(0, q.x), (y, q.y)] {
            let mut row = SVector::<f64, 9>::zeros();
            row.fixed_rows_mut::<3>(axis).copy_from(&x);
            row.fixed_rows_mut::<3>(one).copy_from(&(-x * value));
            outer.syger(1.0, &row, &row, 1.0);
        }
    }
    outer.fill_upper_triangle_with_lower_triangle();
    let fitted = matrix(&smallest_eigenvector(&outer)?);
    let homography = to_2.try_inverse()? * fitted * to_1;
    let unit = homography / homography.norm();
    unit.iter().all(|value| value.is_finite()).then_some(unit)
}

/// Returns the squared transfer error: the distance between H x1 and x2. Infinite at the horizon.
pub(crate) fn transfer2(homography: &Matrix3<f64>, p: &Vector2<f64>, q: &Vector2<f64>) -> f64 {
    let carried = homography * p.push(1.0);
    let error = (carried.xy() / carried.z - q).norm_squared();
    if error.is_finite() { error } else { f64::INFINITY }
}

/// Decomposes a homography between plane coordinates into two relative poses, the smaller rotation first. Lengths are
/// in units of the distance of camera 1 to the plane (Ma, Soatto, Kosecka, Sastry 2004, 5.3.3). Empty if the
/// homography is within 1e-9 of a pure rotation or not finite.
///
/// Both explain a plane equally well. They differ for points off the plane, and for those on it that one of the two puts
/// behind a camera.
pub(crate) fn poses_from_homography(homography: &Matrix3<f64>, pairs: &[PointPair]) -> Vec<Pose> {
    let mut h = homography / svd3(homography).s.y;
    let facing = |[p, q]: &&PointPair| q.push(1.0).dot(&(h * p.push(1.0))) > 0.0;
    if 2 * pairs.iter().filter(facing).count() < pairs.len() {
        h = -h;
    }
    let svd = svd3(&h);
    let (large, small) = (svd.s.x * svd.s.x - 1.0, 1.0 - svd.s.z * svd.s.z);
    let spread = (large + small).sqrt();
    if spread.is_nan() || spread < 1e-9 {
        return Vec::new();
    }
    let along = svd.v.column(0) * small.max(0.0).sqrt() / spread;
    let across = svd.v.column(2) * large.max(0.0).sqrt() / spread;
    let middle = svd.v.column(1).into_owned();
    let mut poses =
        [along + across, along - across].map(|unit| pose_from_homography(&h, &middle, &unit, pairs));
    if poses[1].rotation.trace() > poses[0].rotation.trace() {
        poses.swap(0, 1);
    }
    poses.into_iter().filter(|pose| pose.is_valid()).collect()
}

/// Returns one of the two poses. `middle` and `unit` span the directions in the plane whose length H preserves.
fn pose_from_homography(
    h: &Matrix3<f64>,
    middle: &Vector3<f64>,
    unit: &Vector3<f64>,
    pairs: &[PointPair],
) -> Pose {
    let (first, second) = (h * middle, h * unit);
    let normal = middle.cross(unit);
    let from = Matrix3::from_columns(&[*middle, *unit, normal]);
    let to = Matrix3::from_columns(&[first, second, first.cross(&second)]);
    let rotation = nearest_rotation(&(to * from.transpose()));
    let front = pairs
        .iter()
        .filter(|[p, _]| normal.dot(&p.push(1.0)) > 0.0)
        .count();
    let normal = if 2 * front < pairs.len() { -normal } else { normal };
    let translation = (h - rotation) * normal;
    Pose {
        rotation,
        translation,
    }
}

/// A homography and its inverse.
pub(crate) type InvertibleHomography = [Matrix3<f64>; 2];

/// Returns the homography with the largest consensus, by LO-RANSAC over four points. An error is the larger of the
/// transfer errors in both photos. `noise2`: squared sigma of one unit of error in photo 1 and 2. `limit`: largest
/// error of an inlier in that unit.
pub(crate) fn ransac_homography(
    pairs: &[PointPair],
    noise2: [f64; 2],
    limit: f64,
    options: &RansacOptions,
    rng: &mut Rng,
) -> Option<Consensus<InvertibleHomography>> {
    let both_ways = |homography: Matrix3<f64>| Some([homography, homography.try_inverse()?]);
    let solve = |sample: &[usize; 4]| {
        let side = |side: usize| sample.map(|i| pairs[i][side]);
        four_point(&side(0), &side(1))
            .and_then(both_ways)
            .into_iter()
            .collect()
    };
    let error2 = |[forth, back]: &InvertibleHomography, i: usize| {
        let [p, q] = &pairs[i];
        let errors = [
            transfer2(forth, p, q) / noise2[1],
            transfer2(back, q, p) / noise2[0],
        ];
        errors[0].max(errors[1]) / (limit * limit)
    };
    let improve = |_: &InvertibleHomography, inliers: &[usize]| {
        let agreed: Vec<PointPair> = inliers.iter().map(|&i| pairs[i]).collect();
        fit_homography(&agreed).and_then(both_ways)
    };
    options.lo_ransac(pairs.len(), rng, solve, error2, improve)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::scenes::{plane_of, pose};

    /// Twelve points on the plane n·X = 1 and where two cameras see them.
    fn plane(truth: &Pose, normal: &Vector3<f64>) -> Vec<PointPair> {
        let seen = (0..12).map(|i| {
            let ray = Vector3::new(0.1 * f64::from(i % 4) - 0.2, 0.15 * f64::from(i / 4) - 0.1, 1.0);
            let point = ray / normal.dot(&ray);
            [plane_of(&point), plane_of(&truth.point(&point))]
        });
        seen.collect()
    }

    #[test]
    fn four_and_many_points_on_a_plane_agree() {
        let truth = pose([0.1, 0.05, -0.2], [0.3, -0.1, 0.1]);
        let pairs = plane(&truth, &Vector3::new(0.1, -0.3, 0.25));
        let corner = [0, 3, 8, 11].map(|i| pairs[i]);
        for h in [
            four_point(&corner.map(|p| p[0]), &corner.map(|p| p[1])),
            fit_homography(&pairs),
        ] {
            let worst = pairs
                .iter()
                .map(|[p, q]| transfer2(&h.unwrap(), p, q))
                .fold(0.0, f64::max);
            assert!(worst < 1e-20, "{worst:e}");
        }
        let line = [0.0, 1.0, 2.0, 5.0].map(|x| Vector2::new(x, 2.0 * x));
        assert!(four_point(&line, &corner.map(|p| p[1])).is_none(), "collinear");
    }

    #[test]
    fn one_of_the_two_poses_of_a_homography_is_the_true_one() {
        for (turn, t) in [
            ([0.1, 0.05, -0.2], [0.3, -0.1, 0.1]),
            ([0.0; 3], [0.0, 0.0, -0.5]),
            ([0.0, 0.3, 0.0], [1e-4, 0.0, 0.0]),
        ] {
            let truth = pose(turn, t);
            let normal = Vector3::new(0.1, -0.3, 0.25);
            let pairs = plane(&truth, &normal);
            let poses = poses_from_homography(&(fit_homography(&pairs).unwrap() * -2.0), &pairs);
            let miss = poses.iter().map(|m| {
                // In units of the plane's distance 1 / |n|.
                let t = m.translation / normal.norm();
                (m.rotation - truth.rotation).norm() + (t - truth.translation).norm()
            });
            let miss = miss.fold(1.0, f64::min);
            assert!(miss < 1e-8, "{t:?}: {miss:e}");
        }
    }

    #[test]
    fn a_pure_rotation_has_no_plane() {
        let truth = pose([0.1, 0.05, -0.2], [0.0; 3]);
        let pairs = plane(&truth, &Vector3::z());
        assert!(poses_from_homography(&truth.rotation, &pairs).is_empty());
        assert!(poses_from_homography(&Matrix3::zeros(), &pairs).is_empty());
    }
}
