// The 16 real spherical harmonics of degree 0 to 3 at a unit vector, as marf_field::sh.
fn harmonics_of(at: vec3<f32>) -> array<f32, 16> {
    let x = at.x;
    let y = at.y;
    let z = at.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<f32, 16>(
        0.2820948,
        -0.48860252 * y,
        0.48860252 * z,
        -0.48860252 * x,
        1.0925485 * (x * y),
        -1.0925485 * (y * z),
        0.9461747 * zz - 0.31539157,
        -1.0925485 * (x * z),
        0.54627424 * (xx - yy),
        0.5900436 * y * (yy - 3.0 * xx),
        2.8906114 * (x * y) * z,
        0.4570458 * y * (1.0 - 5.0 * zz),
        0.37317634 * z * (5.0 * zz - 3.0),
        0.4570458 * x * (1.0 - 5.0 * zz),
        1.4453057 * z * (xx - yy),
        0.5900436 * x * (3.0 * yy - xx),
    );
}
