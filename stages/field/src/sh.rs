//! Real spherical harmonics up to degree 3.

/// Number of functions.
pub const COUNT: usize = 16;

/// Returns the 16 real spherical harmonics of degree 0 to 3 at a unit vector (the form instant-ngp uses).
#[inline(always)]
pub fn harmonics([x, y, z]: [f32; 3]) -> [f32; COUNT] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_8,
        -0.488_602_52 * y,
        0.488_602_52 * z,
        -0.488_602_52 * x,
        1.092_548_5 * (x * y),
        -1.092_548_5 * (y * z),
        0.946_174_7 * zz - 0.315_391_57,
        -1.092_548_5 * (x * z),
        0.546_274_24 * (xx - yy),
        0.590_043_6 * y * (yy - 3.0 * xx),
        2.890_611_4 * (x * y) * z,
        0.457_045_8 * y * (1.0 - 5.0 * zz),
        0.373_176_34 * z * (5.0 * zz - 3.0),
        0.457_045_8 * x * (1.0 - 5.0 * zz),
        1.445_305_7 * z * (xx - yy),
        0.590_043_6 * x * (3.0 * yy - xx),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of the product of two functions over a fine grid of the sphere is 1 / 4 pi or 0.
    #[test]
    fn the_harmonics_are_orthonormal() {
        let (rings, sectors) = (200, 400);
        let mut sums = [[0.0_f64; COUNT]; COUNT];
        for ring in 0..rings {
            let z = (f64::from(ring) + 0.5) / f64::from(rings) * 2.0 - 1.0;
            for sector in 0..sectors {
                let angle = (f64::from(sector) + 0.5) / f64::from(sectors) * std::f64::consts::TAU;
                let radius = (1.0 - z * z).sqrt();
                let all = harmonics([radius * angle.cos(), radius * angle.sin(), z].map(|c| c as f32));
                for (i, sums) in sums.iter_mut().enumerate() {
                    for (j, sum) in sums.iter_mut().enumerate() {
                        *sum += f64::from(all[i]) * f64::from(all[j]);
                    }
                }
            }
        }
        let area = 4.0 * std::f64::consts::PI / f64::from(rings * sectors);
        for (i, sums) in sums.iter().enumerate() {
            for (j, sum) in sums.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((sum * area - expected).abs() < 1e-3, "{i} {j}: {}", sum * area);
            }
        }
    }
}
