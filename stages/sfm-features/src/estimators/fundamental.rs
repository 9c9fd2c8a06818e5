//! Fundamental matrices from seven points, and from many.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2};

use super::epipolar::PointPair;
use super::essential::epipolar_row;
use super::roots::real_roots;
use super::svd::{matrix, null_space, smallest_eigenvector, svd3};

/// Returns the fundamental matrices F (unit norm) with x2ᵀ F x1 = 0 for seven points, one to three (Hartley
/// and Zisserman 2004, 11.1.2).
///
/// Any unit will do, but coordinates of about 1 keep most digits. Seven points on a plane leave a larger null space
/// and give arbitrary members of it. Input that is not finite gives no matrix.
pub(crate) fn seven_point(points_1: &[Vector2<f64>; 7], points_2: &[Vector2<f64>; 7]) -> Vec<Matrix3<f64>> {
    let rows: [_; 7] = std::array::from_fn(|i| epipolar_row(&[points_1[i], points_2[i]]));
    if !rows
        .iter()
        .flat_map(|row| row.iter())
        .all(|value| value.is_finite())
    {
        return Vec::new();
    }
    let [first, second]: [SVector<f64, 9>; 2] = null_space(rows);
    let (a, b) = (matrix(&first), matrix(&second));
    // det(a + z b): both ends by determinants, the middle by traces with the other's cofactors.
    let cofactors = |m: &Matrix3<f64>| {
        let row = |i: usize| m.row(i).transpose();
        let rows = [
            row(1).cross(&row(2)),
            row(2).cross(&row(0)),
            row(0).cross(&row(1)),
        ];
        Matrix3::from_rows(&rows.map(|row| row.transpose()))
    };
    let cubic = [
        a.determinant(),
        cofactors(&a).dot(&b),
        cofactors(&b).dot(&a),
        b.determinant(),
    ];
    let members = real_roots(&cubic).into_iter().map(|z| (a + b * z).normalize());
    members
        .filter(|member| member.iter().all(|value| value.is_finite()))
        .collect()
}

/// Returns the fundamental matrix of least weighted squares from eight or more pairs, unit norm
/// (Hartley 1997: centred, mean distance sqrt 2).
///
/// `None` with fewer than eight pairs, or where what comes out is not finite.
pub(crate) fn eight_point(pairs: &[PointPair], weights: &[f64]) -> Option<Matrix3<f64>> {
    if pairs.len() < 8 || weights.len() != pairs.len() {
        return None;
    }
    let (to_1, to_2) = (normalisation(pairs, 0)?, normalisation(pairs, 1)?);
    let mut outer = SMatrix::<f64, 9, 9>::zeros();
    for (pair, weight) in pairs.iter().zip(weights) {
        let row = epipolar_row(&[moved(&to_1, &pair[0]), moved(&to_2, &pair[1])]);
        outer.syger(*weight, &row, &row, 1.0);
    }
    outer.fill_upper_triangle_with_lower_triangle();
    let svd = svd3(&matrix(&smallest_eigenvector(&outer)?));
    let s = nalgebra::Vector3::new(svd.s.x, svd.s.y, 0.0);
    let flat = svd.u * Matrix3::from_diagonal(&s) * svd.v.transpose();
    let fundamental = to_2.transpose() * flat * to_1;
    let unit = fundamental / fundamental.norm();
    unit.iter().all(|value| value.is_finite()).then_some(unit)
}

/// Returns the similarity that centres the points of one photo and scales their mean distance to sqrt 2. `None` if
/// all points are equal.
pub(crate) fn normalisation(pairs: &[PointPair], side: usize) -> Option<Matrix3<f64>> {
    let count = pairs.len() as f64;
    let centre = pairs.iter().map(|pair| pair[side]).sum::<Vector2<f64>>() / count;
    let spread = pairs.iter().map(|pair| (pair[side] - centre).norm()).sum::<f64>() / count;
    let scale = std::f64::consts::SQRT_2 / spread;
    let (x, y) = (-centre.x * scale, -centre.y * scale);
    // Equal points leave a spread of rounding.
    (spread > 1e-12 * centre.amax() && scale.is_finite() && x.is_finite() && y.is_finite())
        .then(|| Matrix3::new(scale, 0.0, x, 0.0, scale, y, 0.0, 0.0, 1.0))
}

/// Applies a similarity of the plane to a point.
pub(crate) fn moved(similarity: &Matrix3<f64>, point: &Vector2<f64>) -> Vector2<f64> {
    point * similarity[(0, 0)] + similarity.fixed_view::<2, 1>(0, 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::epipolar::essential_of;
    use crate::estimators::scenes::{Scene, pose};

    fn miss(got: &Matrix3<f64>, truth: &Matrix3<f64>) -> f64 {
        (got - truth).norm().min((got + truth).norm())
    }

    #[test]
    fn seven_and_eight_points_find_the_matrix() {
        let truth = pose([0.1, -0.2, 0.05], [1.0, 0.3, -0.2]);
        let e = essential_of(&truth).normalize();
        for seed in 0..50 {
            let pairs = Scene::new(seed, 40, &truth, 0.0).pairs;
            let [one, two] = [0, 1].map(|side| std::array::from_fn(|i| pairs[i][side]));
            let best = seven_point(&one, &two)
                .iter()
                .map(|f| miss(f, &e))
                .fold(1.0, f64::min);
            assert!(best < 1e-6, "seed {seed}: {best:e}");
            let eight = eight_point(&pairs, &[1.0; 40]).unwrap();
            assert!(miss(&eight, &e) < 1e-9, "seed {seed}: {:e}", miss(&eight, &e));
        }
    }

    #[test]
    fn pixels_and_far_origins_cost_no_digits() {
        let truth = pose([0.1, -0.2, 0.05], [1.0, 0.3, -0.2]);
        for (scale, origin) in [(700.0, 500.0), (1e-12, 0.0), (1e12, 0.0), (700.0, -1e4)] {
            let shift = Vector2::new(origin, 0.5 * origin);
            let pairs: Vec<PointPair> = Scene::new(1, 40, &truth, 0.0)
                .pairs
                .iter()
                .map(|pair| pair.map(|p| p * scale + shift))
                .collect();
            let f = eight_point(&pairs, &[1.0; 40]).unwrap();
            let worst = pairs
                .iter()
                .map(|p| crate::estimators::epipolar::sampson2(&f, p, [1.0; 2]).sqrt());
            let worst = worst.fold(0.0, f64::max);
            assert!(worst < 1e-7 * scale, "scale {scale:e} origin {origin}: {worst:e}");
        }
    }

    #[test]
    fn degenerate_input_is_finite_or_refused() {
        let equal = [Vector2::new(0.1, 0.2); 2];
        assert!(eight_point(&[equal; 20], &[1.0; 20]).is_none(), "equal points");
        assert!(eight_point(&[equal; 7], &[1.0; 7]).is_none(), "seven");
        assert!(
            eight_point(&[[Vector2::new(f64::NAN, 0.0); 2]; 9], &[1.0; 9]).is_none(),
            "NaN"
        );
        let line: [_; 7] = std::array::from_fn(|i| Vector2::new(i as f64, 2.0 * i as f64));
        assert!(
            seven_point(&line, &line)
                .iter()
                .all(|f| f.iter().all(|v| v.is_finite())),
            "line"
        );
    }
}
