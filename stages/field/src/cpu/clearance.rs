//! How far empty space reaches around a point of the contracted box.

use super::march::{Bits, contract};

/// Occupancy cells of a clearance cell a side: 64^3 bytes for 128^3 cells stay in the second cache.
const COARSE: usize = 2;
/// Kept back of every distance: the rounding of a position, in units of the box.
const MARGIN: f32 = 1e-5;

/// Distance of every coarse cell from the next one with matter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clearance {
    /// Coarse cells a side.
    side: usize,
    /// `[side^3]`, x fastest: coarse cells to the next occupied one by the maximum norm, at most 255; 0 where occupied.
    cells: Vec<u8>,
}

impl Clearance {
    /// Measures the empty space of a grid.
    pub fn new(bits: &Bits) -> Self {
        let (fine, side) = (bits.side as usize, (bits.side as usize).div_ceil(COARSE));
        let mut cells = vec![u8::MAX; side.pow(3)];
        for (index, word) in bits.words.iter().enumerate() {
            let mut left = *word;
            while left != 0 {
                let cell = 64 * index + left.trailing_zeros() as usize;
                left &= left - 1;
                let [x, y, z] = [cell % fine, cell / fine % fine, cell / fine / fine].map(|at| at / COARSE);
                cells[(z * side + y) * side + x] = 0;
            }
        }
        let mut clearance = Self { side, cells };
        // The 13 neighbours that come before a cell, then those behind it: exact for the maximum norm.
        for cell in 0..clearance.cells.len() {
            clearance.lower(cell, 1);
        }
        for cell in (0..clearance.cells.len()).rev() {
            clearance.lower(cell, -1);
        }
        clearance
    }

    /// Lowers a distance to one more than that of the 13 neighbours on one side of it in the order of the cells.
    fn lower(&mut self, cell: usize, side: i64) {
        let n = self.side as i64;
        let at = [
            cell % self.side,
            cell / self.side % self.side,
            cell / self.side / self.side,
        ];
        let [x, y, z] = at.map(|at| at as i64);
        let mut least = self.cells[cell];
        for number in 0..13 {
            let step = [number % 3 - 1, number / 3 % 3 - 1, number / 9 - 1].map(|step: i64| step * side);
            let [x, y, z] = [x + step[0], y + step[1], z + step[2]];
            if [x, y, z].iter().all(|at| (0..n).contains(at)) {
                let neighbour = self.cells[((z * n + y) * n + x) as usize];
                least = least.min(neighbour.saturating_add(1));
            }
        }
        self.cells[cell] = least;
    }

    /// Returns how far every coordinate of a point of the unit box may move before a cell with matter is reached.
    #[inline(always)]
    fn around(&self, at: [f32; 3]) -> f32 {
        let side = self.side as f32;
        // `as` takes NaN to 0.
        let cell = at.map(|at| ((at * side) as usize).min(self.side - 1));
        let reach = self.cells[(cell[2] * self.side + cell[1]) * self.side + cell[0]];
        if reach == 0 {
            return 0.0;
        }
        let free = f32::from(reach) - 1.0;
        let axes = [0, 1, 2].map(|axis| {
            let within = at[axis] * side - cell[axis] as f32;
            within.min(1.0 - within)
        });
        let border = axes[0].min(axes[1]).min(axes[2]).max(0.0);
        ((free + border) / side - MARGIN).max(0.0)
    }

    /// Returns whether all points within `reach` of a point of the scene, by the maximum norm, lie in empty space.
    ///
    /// With m the maximum norm of a point, moving it moves a coordinate of the contracted box, 4 wide, by at most as
    /// much times 4/m - 3/m^2 outside of the inner box and times 1 inside: at most 4/3 anywhere, and at most 4/m. Over
    /// the reach r, m falls to m - r at most. A point that is not finite is not known to be free.
    #[inline(always)]
    pub fn is_free(&self, point: [f32; 3], reach: f32) -> bool {
        let m = point[0].abs().max(point[1].abs()).max(point[2].abs());
        let far = if m > reach {
            reach / (m - reach)
        } else {
            f32::INFINITY
        };
        self.around(contract(point).0) > far.min(reach * (1.0 / 3.0))
    }
}
