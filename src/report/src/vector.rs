//! The little arithmetic of directions that a drawing needs.

/// A place or direction of the world.
pub(super) type Vec3 = [f64; 3];

/// The inner product.
pub(super) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The right-handed outer product.
pub(super) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// a + b.
pub(super) fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// a - b.
pub(super) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    add(a, scaled(b, -1.0))
}

/// a times a number.
pub(super) fn scaled(a: Vec3, factor: f64) -> Vec3 {
    a.map(|value| value * factor)
}

/// `None` for a vector that is too short to have a direction, or not finite.
pub(super) fn unit(a: Vec3) -> Option<Vec3> {
    let length = dot(a, a).sqrt();
    (length > 1e-9 && length.is_finite()).then(|| scaled(a, 1.0 / length))
}
