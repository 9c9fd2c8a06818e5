//! Essential matrices from five points.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2};

use super::epipolar::PointPair;
use super::roots::real_roots;
use super::svd::{matrix, null_space};

/// Coefficients of a polynomial in x, y, z of degree 1 (x y z 1), 2 (xx xy xz yy yz zz x y z 1) and 3 (order of
/// `CUBIC`).
type Linear = [f64; 4];
type Quadric = [f64; 10];
type Cubic = SVector<f64, 20>;

/// Where the product of linear terms i and j goes in a quadric.
const QUADRIC: [[usize; 4]; 4] = [[0, 1, 2, 6], [1, 3, 4, 7], [2, 4, 5, 8], [6, 7, 8, 9]];

/// Position of the product of quadric term i and linear term j, in Nister's order: `xxx yyy xxy xyy xxz xx yyz yy xyz
/// xy | xzz xz x yzz yz y zzz zz z 1`.
const CUBIC: [[usize; 4]; 10] = [
    [0, 2, 4, 5],
    [2, 3, 8, 9],
    [4, 8, 10, 11],
    [3, 1, 6, 7],
    [8, 6, 13, 14],
    [10, 13, 16, 17],
    [5, 9, 11, 12],
    [9, 7, 14, 15],
    [11, 14, 17, 18],
    [12, 15, 18, 19],
];

/// Returns the essential matrices E (unit norm) with x2ᵀ E x1 = 0 for five points, at most ten.
///
/// Nister, PAMI 2004: E = x X + y Y + z Z + W in the null space, ten cubic constraints, Gauss-Jordan, a polynomial of
/// degree 10 in z. Coplanar points are fine. Points on a line, equal points or a pure rotation leave a larger null
/// space and give few, wrong or no matrices, but only finite ones.
pub(crate) fn five_point(plane_1: &[Vector2<f64>; 5], plane_2: &[Vector2<f64>; 5]) -> Vec<Matrix3<f64>> {
    let rows: [_; 5] = std::array::from_fn(|i| epipolar_row(&[plane_1[i], plane_2[i]]));
    if !rows
        .iter()
        .flat_map(|row| row.iter())
        .all(|value| value.is_finite())
    {
        return Vec::new();
    }
    let null: [SVector<f64, 9>; 4] = null_space(rows);
    let Some(system) = eliminated(constraints(&null)) else {
        return Vec::new();
    };
    let rows = [(4, 5), (6, 7), (8, 9)].map(|(upper, lower)| z_row(&system, upper, lower));
    let found = real_roots(&determinant(&rows));
    found
        .into_iter()
        .filter_map(|z| assemble(&null, &rows, z))
        .collect()
}

/// Returns the coefficients of E, row by row, in x2ᵀ E x1 = 0.
pub(crate) fn epipolar_row([p, q]: &PointPair) -> SVector<f64, 9> {
    SVector::from([
        q.x * p.x,
        q.x * p.y,
        q.x,
        q.y * p.x,
        q.y * p.y,
        q.y,
        p.x,
        p.y,
        1.0,
    ])
}

/// Adds the product of two linear polynomials.
fn times(a: &Linear, b: &Linear, sum: &mut Quadric) {
    for i in 0..4 {
        for j in 0..4 {
            sum[QUADRIC[i][j]] += a[i] * b[j];
        }
    }
}

/// Adds the signed product of a quadric and a linear polynomial.
fn times_cubic(a: &Quadric, b: &Linear, sign: f64, sum: &mut Cubic) {
    for i in 0..10 {
        for j in 0..4 {
            sum[CUBIC[i][j]] += sign * a[i] * b[j];
        }
    }
}

/// Returns the coefficients of the ten constraints det E = 0 and 2 E Eᵀ E - tr(E Eᵀ) E = 0.
fn constraints(null: &[SVector<f64, 9>; 4]) -> SMatrix<f64, 10, 20> {
    let e: [[Linear; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| std::array::from_fn(|basis| null[basis][3 * i + j])));
    let mut squares = [[[0.0; 10]; 3]; 3];
    for i in 0..3 {
        for j in i..3 {
            (0..3).for_each(|k| times(&e[i][k], &e[j][k], &mut squares[i][j]));
            squares[j][i] = squares[i][j];
        }
    }
    let half_trace: Quadric =
        std::array::from_fn(|term| 0.5 * (0..3).map(|i| squares[i][i][term]).sum::<f64>());
    for (i, row) in squares.iter_mut().enumerate() {
        (0..10).for_each(|term| row[i][term] -= half_trace[term]);
    }
    let mut system = SMatrix::<f64, 10, 20>::zeros();
    for row in 0..9 {
        let mut cubic = Cubic::zeros();
        (0..3).for_each(|k| times_cubic(&squares[row / 3][k], &e[k][row % 3], 1.0, &mut cubic));
        system.set_row(row, &cubic.transpose());
    }
    let mut cubic = Cubic::zeros();
    for (a, b, c) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
        for (b, c, sign) in [(b, c, 1.0), (c, b, -1.0)] {
            let mut minor = [0.0; 10];
            times(&e[1][b], &e[2][c], &mut minor);
            times_cubic(&minor, &e[0][a], sign, &mut cubic);
        }
    }
    system.set_row(9, &cubic.transpose());
    system
}

/// Returns the system after Gauss-Jordan elimination of the first ten columns. `None` if a pivot is within rounding
/// of 0.
fn eliminated(mut system: SMatrix<f64, 10, 20>) -> Option<SMatrix<f64, 10, 20>> {
    for column in 0..10 {
        let pivot = column + system.view((column, column), (10 - column, 1)).iamax_full().0;
        if system[(pivot, column)].abs() < 1e-14 {
            return None;
        }
        system.swap_rows(column, pivot);
        let scale = 1.0 / system[(column, column)];
        let mut factors = system.column(column).into_owned();
        factors[column] = 0.0;
        for mut other in system.column_iter_mut().skip(column) {
            other[column] *= scale;
            let above = other[column];
            other.axpy(-above, &factors, 1.0);
        }
    }
    Some(system)
}

/// Returns row `upper` minus z times row `lower`: polynomials in z (lowest power first) that multiply x, y and 1.
fn z_row(system: &SMatrix<f64, 10, 20>, upper: usize, lower: usize) -> [[f64; 5]; 3] {
    let (e, f) = (|j: usize| system[(upper, j)], |j: usize| system[(lower, j)]);
    let cubic = |j: usize| [e(j + 2), e(j + 1) - f(j + 2), e(j) - f(j + 1), -f(j), 0.0];
    [
        cubic(10),
        cubic(13),
        [e(19), e(18) - f(19), e(17) - f(18), e(16) - f(17), -f(16)],
    ]
}

/// Returns the determinant of a 3 x 3 matrix of polynomials, lowest power first.
fn determinant(rows: &[[[f64; 5]; 3]; 3]) -> [f64; 11] {
    let mut sum = [0.0; 11];
    for (i, j, k, sign) in [
        (0, 1, 2, 1.0),
        (1, 2, 0, 1.0),
        (2, 0, 1, 1.0),
        (0, 2, 1, -1.0),
        (1, 0, 2, -1.0),
        (2, 1, 0, -1.0),
    ] {
        let mut product = [0.0; 7];
        for a in 0..4 {
            for b in 0..4 {
                product[a + b] += sign * rows[i][0][a] * rows[j][1][b];
            }
        }
        for a in 0..7 {
            for b in 0..5 {
                sum[a + b] += product[a] * rows[k][2][b];
            }
        }
    }
    sum
}

/// Returns the essential matrix of a root z: x and y come from the null vector of the three rows.
fn assemble(null: &[SVector<f64, 9>; 4], rows: &[[[f64; 5]; 3]; 3], z: f64) -> Option<Matrix3<f64>> {
    let at = |terms: &[f64; 5]| terms.iter().rev().fold(0.0, |value, term| value * z + term);
    let b = Matrix3::from_fn(|i, j| at(&rows[i][j]));
    let row = |i: usize| b.row(i).transpose();
    let candidates = [
        row(0).cross(&row(1)),
        row(1).cross(&row(2)),
        row(2).cross(&row(0)),
    ];
    let mut solution = candidates[0];
    for candidate in &candidates[1..] {
        if candidate.norm_squared() > solution.norm_squared() {
            solution = *candidate;
        }
    }
    let (x, y, w) = (solution.x, solution.y, solution.z);
    let essential = null[0] * x + null[1] * y + (null[2] * z + null[3]) * w;
    let unit = essential / essential.norm();
    unit.iter().all(|value| value.is_finite()).then(|| matrix(&unit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimators::epipolar::essential_of;
    use crate::estimators::scenes::{Scene, plane_of, pose};
    use marf_scene::Pose;
    use nalgebra::Vector3;

    fn split(pairs: &[PointPair]) -> [[Vector2<f64>; 5]; 2] {
        [0, 1].map(|photo| std::array::from_fn(|i| pairs[i][photo]))
    }

    /// The distance (up to sign) of the nearest solution to the truth.
    fn miss(truth: &Pose, pairs: &[PointPair]) -> f64 {
        let [plane_1, plane_2] = split(pairs);
        let e = essential_of(truth).normalize();
        let solutions = five_point(&plane_1, &plane_2);
        assert!(solutions.len() <= 10);
        let misses = solutions.iter().map(|s| (s - e).norm().min((s + e).norm()));
        misses.fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn five_points_give_back_the_motion_in_every_direction() {
        let motions = [
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
            [0.3, -0.5, 0.2],
        ];
        let mut missed = [0; 5];
        for (k, t) in motions.into_iter().enumerate() {
            for seed in 0..200 {
                let truth = pose([0.1 * (seed % 7) as f64, -0.15, 0.05 * (seed % 3) as f64], t);
                missed[k] += u32::from(miss(&truth, &Scene::new(seed, 5, &truth, 0.0).pairs) > 1e-3);
            }
        }
        // Five points near a critical position keep fewer digits: 4 of these 1000.
        assert!(missed.iter().all(|&count| count <= 3), "of 200 each: {missed:?}");
    }

    #[test]
    fn solutions_satisfy_their_five_equations_and_are_essential() {
        let truth = pose([0.2, -0.1, 0.3], [1.0, -0.4, 0.2]);
        for seed in 0..50 {
            let pairs = Scene::new(seed, 5, &truth, 0.0).pairs;
            let [plane_1, plane_2] = split(&pairs);
            for e in five_point(&plane_1, &plane_2) {
                let s = crate::estimators::svd::svd3(&e).s;
                assert!((s.x - s.y).abs() < 1e-4 && s.z.abs() < 1e-4, "seed {seed}: {s}");
                assert!(pairs.iter().all(|pair| {
                    epipolar_row(pair)
                        .dot(&SVector::from_row_slice(e.transpose().as_slice()))
                        .abs()
                        < 1e-9
                }));
            }
        }
    }

    #[test]
    fn coplanar_points_and_tiny_baselines_still_work() {
        for (baseline, least) in [(1.0, 1e-6), (1e-2, 1e-4), (1e-5, 1.0)] {
            let truth = pose([0.05, 0.1, -0.02], [baseline, 0.2 * baseline, 0.1 * baseline]);
            let points = (0..5).map(|i| {
                let (x, y) = (libm::cos(1.3 * f64::from(i)), libm::sin(0.9 * f64::from(i) + 0.4));
                Vector3::new(x, y, 5.0 + 0.5 * x - 0.2 * y)
            });
            let scene = Scene::from_points(points.collect(), &truth, 0.0, 1);
            let got = miss(&truth, &scene.pairs);
            assert!(got < least, "baseline {baseline:e}: {got:e}");
        }
    }

    #[test]
    fn degenerate_points_never_give_nan() {
        let truth = pose([0.1, 0.0, 0.0], [1.0, 0.0, 0.0]);
        let line = |i: usize| Vector3::new(i as f64 - 2.0, 0.5 * i as f64, 6.0 + i as f64);
        let collinear: Vec<_> = (0..5).map(line).collect();
        let same = vec![Vector3::new(0.3, 0.2, 5.0); 5];
        for (name, points) in [("collinear", collinear), ("equal", same)] {
            for motion in [truth, pose([0.1, 0.2, 0.0], [0.0; 3]), Pose::identity()] {
                let pairs: Vec<PointPair> = points
                    .iter()
                    .map(|p| [plane_of(p), plane_of(&motion.point(p))])
                    .collect();
                let [plane_1, plane_2] = split(&pairs);
                let finite = five_point(&plane_1, &plane_2)
                    .iter()
                    .all(|e| e.iter().all(|v| v.is_finite()));
                assert!(finite, "{name}");
            }
        }
        let nan = [Vector2::new(f64::NAN, 0.0); 5];
        assert!(five_point(&nan, &nan).is_empty());
    }
}
