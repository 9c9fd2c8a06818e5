//! 16 lanes in plain Rust.

use marf_numeric::Plain;

use super::isa::{Block, Isa, LANES};

/// Applies a function lane by lane.
#[inline(always)]
fn each<T: Copy, R: Copy + Default>(a: [T; LANES], b: [T; LANES], work: fn(T, T) -> R) -> [R; LANES] {
    let mut found = [R::default(); LANES];
    for lane in 0..LANES {
        found[lane] = work(a[lane], b[lane]);
    }
    found
}

impl Isa for Plain {
    type V = [f32; LANES];
    type U = [u32; LANES];
    const WIDE: bool = false;

    #[inline(always)]
    fn splat(self, value: f32) -> Self::V {
        [value; LANES]
    }
    #[inline(always)]
    fn load(self, from: &Block) -> Self::V {
        from.0
    }
    #[inline(always)]
    fn store(self, value: Self::V, to: &mut Block) {
        to.0 = value;
    }
    #[inline(always)]
    fn mul_add(self, a: Self::V, b: Self::V, mut c: Self::V) -> Self::V {
        for lane in 0..LANES {
            c[lane] = a[lane].mul_add(b[lane], c[lane]);
        }
        c
    }
    #[inline(always)]
    fn relu(self, mut value: Self::V) -> Self::V {
        for lane in &mut value {
            *lane = if 0.0 > *lane { 0.0 } else { *lane };
        }
        value
    }
    #[inline(always)]
    fn gate(self, mut value: Self::V, gate: Self::V) -> Self::V {
        for lane in 0..LANES {
            value[lane] = if gate[lane] > 0.0 { value[lane] } else { 0.0 };
        }
        value
    }
    #[inline(always)]
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        each(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn unit(self, value: Self::V) -> Self::V {
        let above = each(value, [0.0; LANES], |x, zero| if x > zero { x } else { zero });
        each(above, [1.0; LANES], |x, one| if x < one { x } else { one })
    }
    #[inline(always)]
    fn whole(self, value: Self::V) -> Self::U {
        each(value, value, |x, _| x as u32)
    }
    #[inline(always)]
    fn float(self, value: Self::U) -> Self::V {
        each(value, value, |x, _| x as f32)
    }
    #[inline(always)]
    fn bits(self, value: Self::V) -> Self::U {
        value.map(f32::to_bits)
    }
    #[inline(always)]
    fn splat_u(self, value: u32) -> Self::U {
        [value; LANES]
    }
    #[inline(always)]
    fn store_u(self, value: Self::U, to: &mut [u32; LANES]) {
        *to = value;
    }
    #[inline(always)]
    fn add_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::wrapping_add)
    }
    #[inline(always)]
    fn mul_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::wrapping_mul)
    }
    #[inline(always)]
    fn xor_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, |a, b| a ^ b)
    }
    #[inline(always)]
    fn and_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, |a, b| a & b)
    }
    #[inline(always)]
    fn min_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::min)
    }
    #[inline(always)]
    fn max_u(self, a: Self::U, b: Self::U) -> Self::U {
        each(a, b, u32::max)
    }
    #[inline(always)]
    fn pack(self, value: Self::V, lanes: u16, to: &mut [f32; LANES]) {
        *to = [0.0; LANES];
        for (to, lane) in to
            .iter_mut()
            .zip((0..LANES).filter(|lane| lanes >> lane & 1 == 1))
        {
            *to = value[lane];
        }
    }
}
