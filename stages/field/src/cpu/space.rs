//! The contracted box, and which of its cells are occupied.

use super::simd::{Block, Isa, LANES};

/// Pulls space outside [-1, 1]^3 into [-2, 2]^3 and maps that to the unit box.
///
/// With m = max(|x|, |y|, |z|): x stays for m <= 1, else x (2 - 1/m) / m (mip-NeRF 360, arXiv 2111.12077, eq. 10,
/// with the maximum norm). Returns the point in [0, 1]^3 and by how much a length shrinks there, 1 / max(1, m).
#[inline(always)]
pub fn contract(p: [f32; 3]) -> ([f32; 3], f32) {
    let m = p[0].abs().max(p[1].abs()).max(p[2].abs());
    let shrink = if m > 1.0 { 1.0 / m } else { 1.0 };
    let scale = if m > 1.0 { (2.0 - shrink) * shrink } else { 1.0 };
    ([0, 1, 2].map(|axis| (p[axis] * scale).mul_add(0.25, 0.5)), shrink)
}

/// Inverts [`contract`] in f64. The border of the box, which is infinity, maps to `1e6`.
pub fn expand(u: [f64; 3]) -> [f64; 3] {
    let v = u.map(|u| (u - 0.5) * 4.0);
    let m = v[0].abs().max(v[1].abs()).max(v[2].abs());
    if m <= 1.0 {
        return v;
    }
    let far = 1.0 / (2.0 - m).max(1e-6);
    v.map(|v| v / m * far)
}

/// One bit a cell of the contracted box.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bits {
    /// Cells a side.
    pub side: u32,
    /// `[side^3 / 64]`, x fastest.
    pub words: Vec<u64>,
}

impl Bits {
    /// Returns a grid whose cells are all empty.
    pub fn new(side: u32) -> Self {
        let cells = (side as usize).pow(3);
        Self {
            side,
            words: vec![0; cells.div_ceil(64)],
        }
    }

    /// Returns whether a cell is occupied.
    #[inline(always)]
    pub fn holds(&self, cell: u32) -> bool {
        self.words[(cell >> 6) as usize] >> (cell & 63) & 1 == 1
    }

    /// Marks a cell as occupied.
    pub fn set(&mut self, cell: usize) {
        self.words[cell >> 6] |= 1 << (cell & 63);
    }

    /// Returns the share of occupied cells.
    pub fn share(&self) -> f64 {
        let occupied: u32 = self.words.iter().map(|word| word.count_ones()).sum();
        f64::from(occupied) / f64::from(self.side).powi(3)
    }

    /// Returns one bit for each of 16 points in the unit box: whether its cell is occupied.
    #[inline(always)]
    pub fn hits<I: Isa>(&self, isa: I, xyz: [&Block; 3]) -> u32 {
        let (cells, last) = (isa.splat(self.side as f32), isa.splat_u(self.side - 1));
        let mut cell = isa.splat_u(0);
        for at in [xyz[2], xyz[1], xyz[0]] {
            let corner = isa.whole(isa.mul(isa.unit(isa.load(at)), cells));
            cell = isa.mul_u(cell, isa.splat_u(self.side));
            cell = isa.add_u(cell, isa.min_u(corner, last));
        }
        let mut lanes = [0; LANES];
        isa.store_u(cell, &mut lanes);
        let mut hits = 0;
        for lane in 0..LANES {
            hits |= u32::from(self.holds(lanes[lane])) << lane;
        }
        hits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contraction_keeps_the_inner_box_and_undoes_itself() {
        assert_eq!(contract([0.5, -1.0, 0.0]), ([0.625, 0.25, 0.5], 1.0));
        // m = 4: the point goes to (2 - 1/4) = 1.75, that is 0.9375.
        assert_eq!(contract([4.0, 0.0, 0.0]), ([0.9375, 0.5, 0.5], 0.25));
        for p in [[0.3, 0.2, -0.9], [3.0, -2.0, 1.0], [0.0, 0.0, 500.0]] {
            let back = expand(contract(p).0.map(f64::from));
            for axis in 0..3 {
                let error = (back[axis] - f64::from(p[axis])).abs();
                assert!(error < 0.02 * (1.0 + f64::from(p[axis]).abs()), "{p:?}: {back:?}");
            }
        }
        let (u, shrink) = contract([f32::MAX, 1.0, 1.0]);
        assert!(
            u.iter().all(|u| (0.0..=1.0).contains(u)) && shrink >= 0.0,
            "{u:?} {shrink}"
        );
    }
}
