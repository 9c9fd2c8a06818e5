//! Cholesky factors of symmetric 3 x 3 matrices, stored as xx, yx, yy, zx, zy, zz.

use nalgebra::Vector3;

/// Returns the lower Cholesky factor of a symmetric 3 x 3 (xx, yx, yy, zx, zy, zz), `None` if it is not positive.
#[inline]
pub(super) fn factor(h: &[f64; 6]) -> Option<[f64; 6]> {
    let positive = |value: f64| (value > 0.0).then(|| value.sqrt());
    let xx = positive(h[0])?;
    let (yx, zx) = (h[1] / xx, h[3] / xx);
    let yy = positive(h[2] - yx * yx)?;
    let zy = (h[4] - zx * yx) / yy;
    let zz = positive(h[5] - zx * zx - zy * zy)?;
    Some([xx, yx, yy, zx, zy, zz])
}

/// Returns the inverse of a lower triangle.
#[inline]
pub(super) fn inverse(lower: [f64; 6]) -> [f64; 6] {
    let [xx, yx, yy, zx, zy, zz] = lower;
    let (xx, yy, zz) = (1.0 / xx, 1.0 / yy, 1.0 / zz);
    let yx = -yx * xx * yy;
    [xx, yx, yy, -(zx * xx + zy * yx) * zz, -zy * yy * zz, zz]
}

/// Returns L⁻¹ v.
#[inline]
pub(super) fn forward(inverse: &[f64; 6], v: &[f64; 3]) -> [f64; 3] {
    [
        inverse[0] * v[0],
        inverse[1] * v[0] + inverse[2] * v[1],
        inverse[3] * v[0] + inverse[4] * v[1] + inverse[5] * v[2],
    ]
}

/// Returns L⁻ᵀ v.
#[inline]
pub(super) fn backward(inverse: &[f64; 6], v: &[f64; 3]) -> Vector3<f64> {
    Vector3::new(
        inverse[0] * v[0] + inverse[1] * v[1] + inverse[3] * v[2],
        inverse[2] * v[1] + inverse[4] * v[2],
        inverse[5] * v[2],
    )
}
