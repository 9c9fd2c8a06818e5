//! Rotations and their logarithms.

use nalgebra::{Matrix3, Vector3};

use super::svd::svd3;

/// Returns the matrix [v]x with [v]x w = v x w.
pub(crate) fn cross_matrix(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Returns the rotation about a vector by its length in radians, by way of the half-angle quaternion: no digits are lost
/// at 0.
pub(crate) fn exp_so3(turn: &Vector3<f64>) -> Matrix3<f64> {
    let half = turn.norm() / 2.0;
    // Below 1e-8 sin(h) / h is 1 in f64.
    let sinc = if half < 1e-8 { 1.0 } else { libm::sin(half) / half };
    let (w, v) = (libm::cos(half), turn * (sinc / 2.0));
    let (outer, skew) = (v * v.transpose(), cross_matrix(&v));
    Matrix3::identity() + (outer - Matrix3::identity() * v.norm_squared() + skew * w) * 2.0
}

/// Returns the rotation vector of a rotation, its length in [0, pi]. Accurate to the last digits at 0 and at pi,
/// where either of the two axes may be returned.
///
/// Shepperd 1978: the quaternion by its largest component, then 2 atan2(|v|, w).
#[inline]
pub fn log_so3(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let r = |i: usize, j: usize| rotation[(i, j)];
    let odd = Vector3::new(r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1));
    let trace = rotation.trace();
    let i = rotation.diagonal().imax();
    let (w, v) = if trace >= r(i, i) {
        (1.0 + trace, odd)
    } else {
        let mut v = Vector3::from_fn(|j, _| r(i, j) + r(j, i));
        v[i] = 1.0 + 2.0 * r(i, i) - trace;
        (odd[i], v)
    };
    let sine = v.norm();
    if sine == 0.0 {
        return Vector3::zeros();
    }
    let (w, v) = if w < 0.0 { (-w, -v) } else { (w, v) };
    v * (2.0 * libm::atan2(sine, w) / sine)
}

/// Returns the rotation nearest to a matrix (Frobenius): U Vᵀ with the sign that keeps the determinant at
/// 1.
#[inline]
pub fn nearest_rotation(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let svd = svd3(matrix);
    svd.u * svd.v.transpose()
}

/// Returns the rotation that best maps unit vectors `from` to unit vectors `to`, weighted (Kabsch 1976). About an
/// axis that parallel vectors leave free it rotates no further than it must.
pub(crate) fn rotation_between(
    pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>, f64)>,
) -> Matrix3<f64> {
    let zero = Matrix3::zeros();
    nearest_rotation(&pairs.fold(zero, |sum, (from, to, weight)| {
        sum + to * from.transpose() * weight
    }))
}

/// Returns the angle between the rays from two centres to a point, in [0, pi]. 0 if a centre is the point. It uses
/// atan2 of sine and cosine: accurate to 1e-16 relative near 0 and near pi, where acos keeps 8 digits.
#[inline]
pub fn ray_angle_rad(centre_1: &Vector3<f64>, centre_2: &Vector3<f64>, point: &Vector3<f64>) -> f64 {
    let (ray_1, ray_2) = (point - centre_1, point - centre_2);
    libm::atan2(ray_1.cross(&ray_2).norm(), ray_1.dot(&ray_2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_quarter_turn_about_z_carries_x_to_y() {
        let quarter = exp_so3(&(Vector3::z() * FRAC_PI_2));
        assert!((quarter * Vector3::x() - Vector3::y()).norm() < 1e-15);
        assert!((log_so3(&quarter) - Vector3::z() * FRAC_PI_2).norm() < 1e-15);
    }

    #[test]
    fn log_undoes_exp_from_nothing_to_half_a_turn() {
        let axes = [
            Vector3::x(),
            -Vector3::y(),
            Vector3::new(1.0, -2.0, 0.5).normalize(),
            Vector3::new(-1.0, 1e-9, 1e-5).normalize(),
        ];
        for axis in axes {
            for angle in [0.0, 1e-300, 1e-12, 1e-5, 0.1, 1.5, 3.0, PI - 1e-5, PI - 1e-12, PI] {
                let turn = axis * angle;
                let rotation = exp_so3(&turn);
                let back = log_so3(&rotation);
                let error = (back - turn)
                    .norm()
                    .min(if angle > 3.1 { (back + turn).norm() } else { 9.0 });
                assert!(
                    error <= 4e-15 * angle.max(1e-3),
                    "angle {angle:e} {axis}: {error:e}"
                );
                let defect = (rotation * rotation.transpose() - Matrix3::identity()).norm();
                assert!(defect < 4e-15, "angle {angle}: {defect:e}");
            }
        }
    }

    #[test]
    fn the_nearest_rotation_to_a_mirror_is_a_rotation() {
        let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        assert!((nearest_rotation(&mirror).determinant() - 1.0).abs() < 1e-15);
        let turn = exp_so3(&Vector3::new(0.3, -0.2, 2.0));
        for scale in [1e-12, 1.0, 1e12] {
            assert!(
                (nearest_rotation(&(turn * scale)) - turn).norm() < 1e-14,
                "scale {scale:e}"
            );
        }
    }

    #[test]
    fn ray_angles_are_right_at_both_ends() {
        for angle in [1e-12, 1e-7, 0.5, 3.0, PI - 1e-7] {
            let centre = Vector3::new(libm::cos(angle), libm::sin(angle), 0.0);
            let got = ray_angle_rad(&Vector3::x(), &centre, &Vector3::zeros());
            assert!((got - angle).abs() < 1e-15 * angle.max(1.0), "{angle:e}: {got:e}");
        }
        assert_eq!(ray_angle_rad(&Vector3::x(), &Vector3::y(), &Vector3::x()), 0.0);
    }
}
