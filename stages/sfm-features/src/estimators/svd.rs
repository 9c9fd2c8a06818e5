//! Small dense factorisations that keep every digit: 3 x 3 singular values, null spaces of 9 unknowns.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// M = U diag(s) Vᵀ with U and V proper rotations, |s| falling. The last s has the sign of det M.
pub(crate) struct Svd3 {
    pub u: Matrix3<f64>,
    pub s: Vector3<f64>,
    pub v: Matrix3<f64>,
}

/// Sweeps that suffice: Jacobi converges quadratically, 3 x 3 matrices in 5 or 6 sweeps.
const SWEEPS: usize = 20;

/// Returns the singular value decomposition of a 3 x 3 matrix by one-sided Jacobi rotations (Hestenes 1958).
///
/// nalgebra's own 3 x 3 case goes through MᵀM and loses half of the digits of small singular values. Singular
/// matrices are welcome (U is completed to a rotation). Input that is not finite gives output that is not finite.
pub(crate) fn svd3(matrix: &Matrix3<f64>) -> Svd3 {
    let (mut b, mut v) = (*matrix, Matrix3::identity());
    for _ in 0..SWEEPS {
        let turned = [(0, 1), (0, 2), (1, 2)].map(|(p, q)| orthogonalise(&mut b, &mut v, p, q));
        if !turned.contains(&true) {
            break;
        }
    }
    let norms = [0, 1, 2].map(|column| b.column(column).norm());
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| norms[j].total_cmp(&norms[i]).then(i.cmp(&j)));
    let pick = |m: &Matrix3<f64>, rank: usize| m.column(order[rank]).into_owned();
    let (v0, v1) = (pick(&v, 0), pick(&v, 1));
    let (u0, u1) = basis(&pick(&b, 0), &pick(&b, 1));
    let (u2, v2) = (u0.cross(&u1), v0.cross(&v1));
    Svd3 {
        u: Matrix3::from_columns(&[u0, u1, u2]),
        s: Vector3::new(norms[order[0]], norms[order[1]], u2.dot(&(matrix * v2))),
        v: Matrix3::from_columns(&[v0, v1, v2]),
    }
}

/// Rotates columns p and q of B, and those of V, until they are orthogonal. False if they already were.
fn orthogonalise(b: &mut Matrix3<f64>, v: &mut Matrix3<f64>, p: usize, q: usize) -> bool {
    let (bp, bq) = (b.column(p).into_owned(), b.column(q).into_owned());
    let (alpha, beta, gamma) = (bp.norm_squared(), bq.norm_squared(), bp.dot(&bq));
    if gamma == 0.0 || gamma.abs() <= 1e-16 * alpha.sqrt() * beta.sqrt() {
        return false;
    }
    let zeta = (beta - alpha) / (2.0 * gamma);
    let t = 1.0_f64.copysign(zeta) / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let c = 1.0 / (1.0 + t * t).sqrt();
    for m in [b, v] {
        let (mp, mq) = (m.column(p).into_owned(), m.column(q).into_owned());
        m.set_column(p, &(c * mp - c * t * mq));
        m.set_column(q, &(c * t * mp + c * mq));
    }
    true
}

/// Returns two orthonormal vectors along two nearly orthogonal columns. The second column may be zero.
fn basis(b0: &Vector3<f64>, b1: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let u0 = b0.try_normalize(0.0).unwrap_or_else(Vector3::x);
    let rest = b1 - u0 * u0.dot(b1);
    let clear = rest.norm() > 1e-14 * b0.norm();
    let u1 = if clear {
        rest.normalize()
    } else {
        any_orthogonal(&u0)
    };
    // Once more: the first projection leaves a rest of 1e-16 / |b1|.
    (u0, (u1 - u0 * u0.dot(&u1)).normalize())
}

/// Returns a unit vector orthogonal to a unit vector.
pub(crate) fn any_orthogonal(unit: &Vector3<f64>) -> Vector3<f64> {
    let mut axis = Vector3::zeros();
    axis[unit.iamin()] = 1.0;
    (axis - unit * unit.dot(&axis)).normalize()
}

/// Returns orthonormal vectors orthogonal to every row, by Householder reflections. `FREE` is 9 - `ROWS`.
///
/// Rows that depend on each other leave a larger null space, and these vectors do not span all of it. The caller's
/// solutions are then wrong but finite.
pub(crate) fn null_space<const ROWS: usize, const FREE: usize>(
    mut rows: [SVector<f64, 9>; ROWS],
) -> [SVector<f64, 9>; FREE] {
    let mut mirrors = [SVector::<f64, 9>::zeros(); ROWS];
    for i in 0..ROWS {
        let mut mirror = rows[i];
        mirror.rows_mut(0, i).fill(0.0);
        let norm = mirror.norm();
        mirror[i] += norm.copysign(mirror[i]);
        if let Some(mirror) = mirror.try_normalize(0.0) {
            mirrors[i] = mirror;
            for row in &mut rows[i + 1..] {
                *row -= mirror * (2.0 * mirror.dot(row));
            }
        }
    }
    std::array::from_fn(|free| {
        let mut vector = SVector::<f64, 9>::zeros();
        vector[ROWS + free] = 1.0;
        for mirror in mirrors.iter().rev() {
            vector -= mirror * (2.0 * mirror.dot(&vector));
        }
        vector
    })
}

/// Returns the eigenvector of the smallest eigenvalue of a symmetric matrix. `None` if the matrix is not finite.
pub(crate) fn smallest_eigenvector(outer: &SMatrix<f64, 9, 9>) -> Option<SVector<f64, 9>> {
    let eigen = outer
        .iter()
        .all(|value| value.is_finite())
        .then(|| outer.symmetric_eigen())?;
    Some(eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned())
}

/// Returns the matrix of nine numbers, row by row.
pub(crate) fn matrix(rows: &SVector<f64, 9>) -> Matrix3<f64> {
    Matrix3::from_row_slice(rows.as_slice())
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_numeric::Rng;

    #[test]
    fn factors_multiply_back_for_any_rank_and_scale() {
        let mut rng = Rng::new(1);
        for trial in 0..300 {
            let mut random = || Matrix3::from_fn(|_, _| rng.unit_f64() - 0.5);
            let (left, right) = (random(), random());
            let kept = [1.0, 1e-3, 1e-9, 0.0][trial % 4];
            let scale = [1.0, 1e-100, 1e100][trial % 3];
            let middle = Matrix3::from_diagonal(&Vector3::new(1.0, kept, [kept, 0.0][trial % 2]));
            let m = left * middle * right * scale;
            let Svd3 { u, s, v } = svd3(&m);
            let back = u * Matrix3::from_diagonal(&s) * v.transpose();
            assert!(
                (back - m).norm() < 1e-14 * m.norm(),
                "trial {trial}: {}",
                (back - m).norm()
            );
            for turn in [u, v] {
                let defect = (turn * turn.transpose() - Matrix3::identity()).norm();
                assert!(
                    defect < 1e-13 && turn.determinant() > 0.0,
                    "trial {trial}: {defect:e}"
                );
            }
            assert!(s.x >= s.y && s.y >= s.z.abs() - 1e-14 * s.x, "trial {trial}: {s}");
        }
        let zero = svd3(&Matrix3::zeros());
        assert_eq!(zero.s, Vector3::zeros());
        assert!(zero.u.determinant() > 0.5);
    }

    #[test]
    fn null_vectors_are_orthonormal_and_annihilated_even_for_dependent_rows() {
        let mut rng = Rng::new(2);
        let mut rows = [(); 5].map(|()| SVector::<f64, 9>::from_fn(|_, _| rng.unit_f64() - 0.5));
        rows[4] = rows[0] * 2.0;
        for rows in [rows, [SVector::zeros(); 5]] {
            let null: [_; 4] = null_space(rows);
            for i in 0..4 {
                assert!(
                    rows.iter().all(|row| row.dot(&null[i]).abs() < 1e-14),
                    "vector {i}"
                );
                assert!((0..4).all(|j| (null[i].dot(&null[j]) - f64::from(i == j)).abs() < 1e-14));
            }
        }
    }
}
