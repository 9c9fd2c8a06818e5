//! How far empty space reaches around a point of the contracted box.

use super::simd::{Block, Isa, LANES};
use super::space::{Bits, contract};

/// Occupancy cells of a clearance cell a side: 64^3 bytes for 128^3 cells stay in the second cache.
const COARSE: usize = 2;
/// Kept back of every distance: the rounding of a position, in units of the box.
const MARGIN: f32 = 1e-5;

/// Distance of every coarse cell from the next one with matter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clearance {
    /// Coarse cells a side.
    side: usize,
    /// `[(side + 2)^3]`, x fastest, a border of 255 around: coarse cells to the next occupied one by the
    /// maximum norm, at most 255. 0 where occupied.
    cells: Vec<u8>,
}

impl Clearance {
    /// Measures the empty space of a grid.
    pub fn new(bits: &Bits) -> Self {
        let side = (bits.side as usize).div_ceil(COARSE);
        let cells = vec![u8::MAX; (side + 2).pow(3)];
        let mut clearance = Self { side, cells };
        clearance.mark(bits);
        // The 13 neighbours that come before a cell, then those behind it: exact for the maximum norm.
        let rows = || (1..=side).flat_map(move |z| (1..=side).map(move |y| (y, z)));
        let mut row = vec![u8::MAX; side + 2];
        for (y, z) in rows() {
            let beside = [(y - 1, z - 1), (y, z - 1), (y + 1, z - 1), (y - 1, z)];
            clearance.lower(&mut row, y, z, beside);
            for x in 1..=side {
                row[x] = row[x].min(row[x - 1].saturating_add(1));
            }
            clearance.row_mut(y, z).copy_from_slice(&row);
        }
        for (y, z) in rows().rev() {
            let beside = [(y + 1, z + 1), (y, z + 1), (y - 1, z + 1), (y + 1, z)];
            clearance.lower(&mut row, y, z, beside);
            for x in (1..=side).rev() {
                row[x] = row[x].min(row[x + 1].saturating_add(1));
            }
            clearance.row_mut(y, z).copy_from_slice(&row);
        }
        clearance
    }

    /// Gives the cells with matter their 0.
    fn mark(&mut self, bits: &Bits) {
        let fine = bits.side as usize;
        for (index, word) in bits.words.iter().enumerate() {
            // Of two neighbours along x, which are one coarse cell, the first: a row has an even number of cells.
            let mut left = (word | word >> 1) & 0x5555_5555_5555_5555;
            let first = 64 * index;
            let [first_x, first_y, first_z] = [first % fine, first / fine % fine, first / fine / fine];
            while left != 0 {
                let [mut x, mut y, mut z] = [first_x + left.trailing_zeros() as usize, first_y, first_z];
                left &= left - 1;
                while x >= fine {
                    x -= fine;
                    y += 1;
                    if y == fine {
                        (y, z) = (0, z + 1);
                    }
                }
                let at = self.at([x, y, z].map(|at| at / COARSE));
                self.cells[at] = 0;
            }
        }
    }

    /// Returns the place of a cell.
    #[inline(always)]
    fn at(&self, [x, y, z]: [usize; 3]) -> usize {
        let side = self.side + 2;
        ((z + 1) * side + y + 1) * side + x + 1
    }

    /// Returns a row with its borders. y and z count from the border.
    fn row_mut(&mut self, y: usize, z: usize) -> &mut [u8] {
        let side = self.side + 2;
        &mut self.cells[(z * side + y) * side..][..side]
    }

    /// Copies a row, lowered to one more than the neighbouring cells in four other rows.
    fn lower(&self, row: &mut [u8], y: usize, z: usize, beside: [(usize, usize); 4]) {
        let side = self.side + 2;
        let row_at = |y: usize, z: usize| &self.cells[(z * side + y) * side..][..side];
        row.copy_from_slice(row_at(y, z));
        for (y, z) in beside {
            let beside = row_at(y, z);
            let (before, after) = (&beside[..self.side], &beside[2..]);
            let beside = before.iter().zip(&beside[1..]).zip(after);
            for (cell, ((before, here), after)) in row[1..].iter_mut().zip(beside) {
                let least = (*before).min(*here).min(*after);
                *cell = (*cell).min(least.saturating_add(1));
            }
        }
    }

    /// Returns one bit for each of 16 points of the scene: whether matter may be within `reach` of it, by the
    /// maximum norm.
    ///
    /// With m the maximum norm of a point, moving it moves a coordinate of the contracted box, 4 wide, by at most as
    /// much times 4/m - 3/m^2 outside of the inner box and times 1 inside: at most 4/3 anywhere, and at most 4/m. Over
    /// the reach r, m falls to m - r at most. With a the clearance in the unit box, either of r / 3 < a and r / (m - r) < a
    /// leaves the points in empty space.
    #[inline(always)]
    pub fn near<I: Isa>(&self, isa: I, points: &[Block; 3], reach: &Block) -> u32 {
        let (mut at, mut m) = ([Block::ZERO; 3], Block::ZERO);
        for lane in 0..LANES {
            let point = [points[0].0[lane], points[1].0[lane], points[2].0[lane]];
            m.0[lane] = point[0].abs().max(point[1].abs()).max(point[2].abs());
            let contracted = contract(point).0;
            for axis in 0..3 {
                at[axis].0[lane] = contracted[axis];
            }
        }
        let around = self.around(isa, &at);
        let mut near = [0_u32; LANES];
        for lane in 0..LANES {
            let around = around.0[lane];
            let free = (3.0 * around).max(around / (1.0 + around) * m.0[lane]);
            near[lane] = u32::from(!(around > 0.0 && free > reach.0[lane]));
        }
        (0..LANES).fold(0, |bits, lane| bits | near[lane] << lane)
    }

    /// Returns how far each coordinate of 16 points of the unit box may move before it reaches a cell with
    /// matter. 0 or less inside one.
    #[inline(always)]
    fn around<I: Isa>(&self, isa: I, at: &[Block; 3]) -> Block {
        let (side, last) = (isa.splat(self.side as f32), isa.splat_u(self.side as u32 - 1));
        let (mut cell, mut border) = (isa.splat_u(0), Block([1.0; LANES]));
        for axis in [2, 1, 0] {
            let place = isa.mul(isa.unit(isa.load(&at[axis])), side);
            let corner = isa.min_u(isa.whole(place), last);
            cell = isa.mul_u(cell, isa.splat_u(self.side as u32 + 2));
            cell = isa.add_u(cell, isa.add_u(corner, isa.splat_u(1)));
            let mut within = Block::ZERO;
            isa.store(isa.sub(place, isa.float(corner)), &mut within);
            for lane in 0..LANES {
                border.0[lane] = border.0[lane].min(within.0[lane]).min(1.0 - within.0[lane]);
            }
        }
        let mut lanes = [0; LANES];
        isa.store_u(cell, &mut lanes);
        let mut around = Block::ZERO;
        for lane in 0..LANES {
            let cells = f32::from(self.cells[lanes[lane] as usize]);
            around.0[lane] = (cells - 1.0 + border.0[lane]) / self.side as f32 - MARGIN;
        }
        around
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, random_numbers};

    #[test]
    fn a_cell_is_as_far_from_matter_as_the_nearest_that_holds_some() {
        let mut rng = random_numbers(3, Purpose::Occupancy, 0, 0);
        for (side, share) in [(16, 0.01), (20, 0.002), (64, 1e-4), (36, 0.0), (16, 1.0)] {
            let mut bits = Bits::new(side);
            let all = side.pow(3);
            let held: Vec<u32> = (0..all).filter(|_| rng.unit_f32() < share).collect();
            held.iter().for_each(|cell| bits.set(*cell as usize));
            let coarse = |cell: u32| [cell % side, cell / side % side, cell / side / side].map(|at| at / 2);
            let clearance = Clearance::new(&bits);
            for _ in 0..200 {
                let at = coarse(rng.below(u64::from(all)) as u32);
                let far = held.iter().map(|cell| {
                    let other = coarse(*cell);
                    (0..3).map(|axis| at[axis].abs_diff(other[axis])).max().unwrap()
                });
                let expected = far.min().unwrap_or(255);
                let found = clearance.cells[clearance.at(at.map(|at| at as usize))];
                assert_eq!(u32::from(found), expected, "{side} cells a side, {at:?}");
            }
        }
    }
}
