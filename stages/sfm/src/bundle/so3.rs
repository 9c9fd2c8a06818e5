//! Rotations as vectors: axis times angle, radian.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Returns the rotation exp([vector]).
pub(super) fn exp(vector: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::new(*vector).into_inner()
}

/// Returns the rotation vector of a rotation, its length in [0, π]. The quaternion makes it accurate near 0 and near
/// π.
pub(super) fn log(rotation: &Matrix3<f64>) -> Vector3<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation)).scaled_axis()
}

/// Returns d log(exp([e]) exp([vector])) / d e at e = 0: I - ½ [vector] + c [vector]², c = 1/θ² - cot(θ/2) / (2 θ)
/// (Chirikjian 2012, inverse left Jacobian of SO(3)).
pub(super) fn log_jacobian(vector: &Vector3<f64>) -> Matrix3<f64> {
    let theta2 = vector.norm_squared();
    // Below 0.1 rad the two terms cancel. The series' next term is 1e-12 there.
    let c = if theta2 < 1e-2 {
        1.0 / 12.0 + theta2 * (1.0 / 720.0 + theta2 * (1.0 / 30240.0 + theta2 / 1_209_600.0))
    } else {
        let theta = theta2.sqrt();
        1.0 / theta2 - 1.0 / (2.0 * theta * libm::tan(0.5 * theta))
    };
    let cross = vector.cross_matrix();
    Matrix3::identity() - cross * 0.5 + cross * cross * c
}

/// Returns the rotation near a matrix that is nearly one: one Newton step R (3 I - RᵀR) / 2, which squares the defect.
pub(super) fn orthonormal(rotation: &Matrix3<f64>) -> Matrix3<f64> {
    rotation * (Matrix3::identity() * 3.0 - rotation.tr_mul(rotation)) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    const VECTORS: [[f64; 3]; 6] = [
        [0.0, 0.0, 0.0],
        [1e-9, 0.0, -1e-9],
        [0.05, -0.02, 0.07],
        [0.4, -1.2, 0.3],
        [0.0, 3.13, 0.0],
        [1.8, -1.8, 1.8],
    ];

    #[test]
    fn log_undoes_exp_from_none_to_half_a_turn() {
        for vector in VECTORS.map(Vector3::from) {
            let back = log(&exp(&vector));
            assert!((back - vector).norm() < 1e-12, "{vector} became {back}");
        }
    }

    #[test]
    fn the_jacobian_of_log_agrees_with_central_differences() {
        let h = 1e-6;
        for vector in VECTORS.map(Vector3::from) {
            for axis in 0..3 {
                let e = Vector3::from_fn(|row, _| if row == axis { h } else { 0.0 });
                let slope = (log(&(exp(&e) * exp(&vector))) - log(&(exp(&-e) * exp(&vector)))) / (2.0 * h);
                let error = (slope - log_jacobian(&vector).column(axis)).norm();
                assert!(error < 1e-8, "{vector}, axis {axis}: {error}");
            }
        }
    }

    #[test]
    fn a_matrix_near_a_rotation_becomes_one() {
        let skewed = exp(&Vector3::new(0.3, 0.2, -0.9)) + Matrix3::from_element(1e-5);
        let rotation = orthonormal(&orthonormal(&skewed));
        let defect = (rotation.tr_mul(&rotation) - Matrix3::identity()).abs().max();
        assert!(defect < 1e-15, "{defect}");
    }
}
