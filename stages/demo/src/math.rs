//! Mathematics with the same bits on every machine: only + - * / sqrt and floor, no libm.

use marf_numeric::linear_light;

/// Three numbers: a point or direction in metres, or linear RGB.
pub type V3 = nalgebra::Vector3<f64>;

pub const fn v3(x: f64, y: f64, z: f64) -> V3 {
    V3::new(x, y, z)
}

/// What nalgebra's vectors lack.
pub trait Vector {
    /// Returns the direction, by a product with 1 / norm. nalgebra's `normalize` divides, which gives other bits.
    fn unit(self) -> Self;

    /// Returns the value at a share of the way to another.
    fn mix(self, other: Self, share: f64) -> Self;
}

impl Vector for V3 {
    fn unit(self) -> Self {
        self * (1.0 / self.dot(&self).sqrt())
    }

    fn mix(self, other: Self, share: f64) -> Self {
        self * (1.0 - share) + other * share
    }
}

pub const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Returns (sin, cos) by Taylor's series after reduction to a quarter turn, within 1e-14 for |angle| < 1000.
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    let quarters = (angle_rad / std::f64::consts::FRAC_PI_2 + 0.5).floor();
    let a = angle_rad - quarters * std::f64::consts::FRAC_PI_2;
    let a2 = a * a;
    // 1 - a2/d1 (1 - a2/d2 (1 - ...)), from the innermost bracket.
    let around = |inner: f64, divisor: &f64| 1.0 - a2 / divisor * inner;
    let series = |divisors: &[f64]| divisors.iter().rfold(1.0, around);
    let sin = a * series(&[6.0, 20.0, 42.0, 72.0, 110.0, 156.0]);
    let cos = series(&[2.0, 12.0, 30.0, 56.0, 90.0, 132.0, 182.0]);
    match quarters as i64 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// Returns 0 below `from`, 1 above `to`, and a smooth transition between. Decreasing if `from` > `to`.
pub fn smoothstep(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Mixes 32 bits so that every bit depends on all (the finaliser of MurmurHash3).
pub fn mix32(mut h: u32) -> u32 {
    h ^= h >> 16;
    h = h.wrapping_mul(0x85eb_ca6b);
    h ^= h >> 13;
    h = h.wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

/// Returns the random number in [0, 1) of a lattice cell.
pub fn cell(x: i64, y: i64, salt: u32) -> f64 {
    f64::from(cell_bits(x, y, salt)) * (1.0 / 4_294_967_296.0)
}

pub fn cell_bits(x: i64, y: i64, salt: u32) -> u32 {
    mix32((x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca77).rotate_left(13) ^ salt)
}

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct Rng(marf_numeric::Rng);

impl Rng {
    /// Returns one of the streams of a seed. Streams of different numbers are independent.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut rng = marf_numeric::Rng::new(seed ^ stream.wrapping_mul(0xd134_2543_de82_ef95));
        rng.bits();
        Self(rng)
    }

    /// Returns the next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// Returns a number in [from, to).
    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.0.unit_f64()
    }

    /// Returns a roughly normal number: mean 0, deviation 1, at most 3 from 0 (a sum of twelve uniform numbers).
    pub fn normal(&mut self) -> f64 {
        let sum: f64 = (0..12).map(|_| self.within(0.0, 1.0)).sum();
        (sum - 6.0).clamp(-3.0, 3.0)
    }

    /// Returns a unit vector, uniform over the sphere.
    pub fn direction(&mut self) -> V3 {
        let z = self.within(-1.0, 1.0);
        let (sin, cos) = sin_cos(self.within(0.0, 2.0 * std::f64::consts::PI));
        let side = (1.0 - z * z).sqrt();
        v3(side * cos, side * sin, z)
    }
}

/// Returns a number's floor and fraction. `f64::floor` is a function call on baseline x86-64, this is not.
pub fn split_floor(x: f64) -> (i64, f64) {
    let cut = x as i64;
    let floor = cut - i64::from(x < cut as f64);
    (floor, x - floor as f64)
}

fn quintic(t: f64) -> (f64, f64) {
    let s = t - 1.0;
    (t * t * t * (t * (t * 6.0 - 15.0) + 10.0), 30.0 * t * t * s * s)
}

/// Returns value noise in the plane, lattice 1: (value in [-1, 1], d/dx, d/dy).
pub fn noise2(x: f64, y: f64, salt: u32) -> (f64, f64, f64) {
    let ((i, fx), (j, fy)) = (split_floor(x), split_floor(y));
    let ((u, du), (v, dv)) = (quintic(fx), quintic(fy));
    let corner = |di, dj| cell(i + di, j + dj, salt) * 2.0 - 1.0;
    let (a, b, c, d) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
    let twist = a - b - c + d;
    (
        a + (b - a) * u + (c - a) * v + twist * u * v,
        du * (b - a + twist * v),
        dv * (c - a + twist * u),
    )
}

/// Returns value noise in space, lattice 1: value in [-1, 1] and gradient.
pub fn noise3(p: V3, salt: u32) -> (f64, V3) {
    let (k, fz) = split_floor(p.z);
    let (k, (w, dw)) = (k as u32, quintic(fz));
    let (a, ax, ay) = noise2(p.x, p.y, salt ^ mix32(k));
    let (b, bx, by) = noise2(p.x, p.y, salt ^ mix32(k.wrapping_add(1)));
    (
        a + (b - a) * w,
        v3(ax + (bx - ax) * w, ay + (by - ay) * w, dw * (b - a)),
    )
}

/// Converts linear light to 8-bit sRGB by a table of its 255 thresholds.
pub struct SrgbEncoder {
    /// `coarse[i]`: the code of i / 4096.
    coarse: Vec<u8>,
    /// `thresholds[v]`: the least linear light of code v + 1.
    thresholds: Vec<f64>,
}

impl SrgbEncoder {
    pub fn new() -> Self {
        let thresholds: Vec<f64> = (0..255)
            .map(|v| linear_light((f64::from(v) + 0.5) / 255.0))
            .collect();
        let code_of = |light: f64| thresholds.partition_point(|&least| least <= light) as u8;
        let coarse = (0..=4096).map(|i| code_of(f64::from(i) / 4096.0)).collect();
        Self { coarse, thresholds }
    }

    pub fn code_of(&self, light: f64) -> u8 {
        let light = light.clamp(0.0, 1.0);
        let mut value = self.coarse[(light * 4096.0) as usize];
        while value < 255 && self.thresholds[usize::from(value)] <= light {
            value += 1;
        }
        value
    }

    pub fn rgb(&self, light: V3) -> [u8; 3] {
        [light.x, light.y, light.z].map(|channel| self.code_of(channel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_agree_with_the_library() {
        for i in -2000..2000 {
            let angle = f64::from(i) * 0.0317;
            let (sin, cos) = sin_cos(angle);
            assert!((sin - angle.sin()).abs() < 1e-12, "sin {angle}: {sin}");
            assert!((cos - angle.cos()).abs() < 1e-12, "cos {angle}: {cos}");
        }
    }

    #[test]
    fn every_8_bit_value_survives_light_and_back() {
        let display = SrgbEncoder::new();
        for value in 0..=255_u8 {
            let light = linear_light(f64::from(value) / 255.0);
            assert_eq!(display.code_of(light), value, "light {light}");
        }
        assert_eq!((display.code_of(-1.0), display.code_of(9.0)), (0, 255));
        assert!((linear_light(0.5) - 0.214_041_140_482).abs() < 1e-9);
    }

    #[test]
    fn noise_slopes_are_its_central_differences() {
        for (x, y, z) in [(0.3, 0.7, 0.2), (-5.2, 8.9, -3.3), (100.1, -0.4, 7.7)] {
            let step = 1e-6;
            let (_, slope) = noise3(v3(x, y, z), 7);
            let along = |d: V3| (noise3(v3(x, y, z) + d, 7).0 - noise3(v3(x, y, z) - d, 7).0) / (2.0 * step);
            let central = v3(
                along(v3(step, 0.0, 0.0)),
                along(v3(0.0, step, 0.0)),
                along(v3(0.0, 0.0, step)),
            );
            assert!(
                (slope - central).norm() < 1e-7,
                "{x} {y} {z}: {slope:?} {central:?}"
            );
        }
    }
}
