//! Which cells of the contracted box may hold matter.

use rayon::prelude::*;

use crate::View;
use crate::cpu::space::{Bits, contract, expand};
use crate::frame::Frame;
use crate::rng::{Purpose, random_numbers};
use crate::seen::seen_cells;

/// A cell counts as occupied if a step of the shortest length in it has at least this optical depth, or the
/// mean of all cells if that is less (instant-ngp).
pub const OCCUPIED: f32 = 0.04;
/// Share of a density that remains when its cell is probed again.
pub const DECAY: f32 = 0.8;
/// Density of a cell that has not been looked at: it stays occupied until it is. exp(10) is the most otherwise.
pub const UNKNOWN: f32 = 1e6;
/// Cells are due by this times their number plus that of the update: neighbours in different ones. Odd.
pub const SPREAD: u64 = 7;
/// Words of 64 cells that one task takes.
const WORDS: usize = 256;

/// Densities of cells and the bits made from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Occupancy {
    /// `[side^3]`, x fastest. -1 where no camera looks.
    pub density: Vec<f32>,
    /// Cells that rays visit.
    pub bits: Bits,
    /// How empty cells become occupied.
    pub refill: Refill,
}

/// When an empty cell becomes occupied again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refill {
    /// At the density of occupied ones: while all is thin, at the mean.
    AtMean,
    /// At a density that shows by itself: thin cells stay empty even if they are above the mean.
    WhereItShows,
}

/// A cell to look at, and a random point in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// The cell.
    pub cell: u32,
    /// The point, in the unit box.
    pub at: [f32; 3],
}

/// One in this many occupied cells is probed in an update.
pub const OCCUPIED_EVERY: u64 = 4;

/// Returns one in how many of the occupied cells, and of the empty ones, is due at an update: all once in the first four.
///
/// Empty cells as often as occupied ones up to update 16 cost a fifth of these steps.
pub fn due_every(round: u64) -> [u64; 2] {
    let empty = if round <= OCCUPIED_EVERY {
        OCCUPIED_EVERY
    } else {
        16
    };
    [OCCUPIED_EVERY, empty]
}

impl Occupancy {
    /// Returns a grid with all seen cells occupied.
    pub fn full(side: u32, frame: &Frame, views: &[View]) -> Self {
        let seen = seen_cells(side, frame, views);
        let mut bits = Bits::new(side);
        for (cell, _) in seen.iter().enumerate().filter(|(_, seen)| **seen) {
            bits.set(cell);
        }
        let density = seen.iter().map(|seen| if *seen { UNKNOWN } else { -1.0 });
        Self {
            density: density.collect(),
            bits,
            refill: Refill::AtMean,
        }
    }

    /// Returns a grid over another box whose seen cells have the densities of the cells of this grid at their
    /// place.
    ///
    /// `from`: the box of this grid, `to`: that of the new one. A cell is as dense as the densest cell that
    /// contains its centre or a corner. Where nothing was found, a cell fills once it shows.
    pub fn moved(&self, from: &Frame, to: &Frame, views: &[View]) -> Self {
        let side = self.bits.side;
        let seen = seen_cells(side, to, views);
        let densest = |cell: u32| {
            let corner = [cell % side, cell / side % side, cell / side / side];
            let places = (0..9_u32).map(|place| {
                let at = |axis: u32| match place {
                    8 => 0.5,
                    _ => f64::from(place >> axis & 1),
                };
                [0, 1, 2].map(|axis: usize| (f64::from(corner[axis]) + at(axis as u32)) / f64::from(side))
            });
            places
                .map(|at| self.density_at(from.inward(&to.outward(expand(at)))))
                .fold(0.0, f32::max)
        };
        let cells = seen.par_iter().enumerate();
        let density: Vec<f32> = cells
            .map(|(cell, seen)| if *seen { densest(cell as u32) } else { -1.0 })
            .collect();
        let mut bits = Bits::new(side);
        for (cell, _) in density.iter().enumerate().filter(|(_, density)| **density > 0.0) {
            bits.set(cell);
        }
        Self {
            density,
            bits,
            refill: Refill::WhereItShows,
        }
    }

    /// Returns the grid with the occupancy of `bits` in the cells that `views` see. Cells empty in `bits`
    /// fill where they are found dense, and the others are probed again. `frame`: the box of both.
    pub fn known(&self, bits: &Bits, frame: &Frame, views: &[View]) -> Self {
        let seen = seen_cells(self.bits.side, frame, views);
        let mut grid = self.clone();
        for (cell, density) in grid.density.iter_mut().enumerate() {
            if seen[cell] && *density >= 0.0 {
                *density = if bits.holds(cell as u32) { UNKNOWN } else { 0.0 };
            }
        }
        let cells = grid.density.iter().enumerate();
        let mut own = Bits::new(self.bits.side);
        for (cell, _) in cells.filter(|(_, density)| **density >= UNKNOWN) {
            own.set(cell);
        }
        grid.bits = own;
        grid
    }

    /// Returns the density of the occupied cell around a point given in half sides, 0 where it is empty.
    fn density_at(&self, point: [f64; 3]) -> f32 {
        let side = self.bits.side;
        let corner = contract(point.map(|x| x as f32))
            .0
            .map(|x| ((x * side as f32) as u32).min(side - 1));
        let cell = (corner[2] * side + corner[1]) * side + corner[0];
        if self.bits.holds(cell) {
            self.density[cell as usize]
        } else {
            0.0
        }
    }

    /// Returns the share of cells that some camera sees.
    pub fn seen_share(&self) -> f64 {
        let seen = self.density.iter().filter(|density| **density >= 0.0).count();
        seen as f64 / self.density.len() as f64
    }

    /// Chooses the cells of update number `round`: of occupied cells one in `occupied`, of empty ones one in `empty`, both
    /// divisors of 64.
    pub fn probes(&self, seed: u64, round: u64, occupied: u64, empty: u64) -> Vec<Probe> {
        // 64 is a multiple of both, so that the cells that are due have the same places in every word.
        let due = |every: u64| {
            let bits = (0..64).filter(|bit| (bit * SPREAD + round).is_multiple_of(every));
            bits.fold(0_u64, |word, bit| word | 1 << bit)
        };
        let (occupied, empty) = (due(occupied), due(empty));
        let words = self.bits.words.par_iter().enumerate();
        let probes = words.with_min_len(WORDS).flat_map_iter(|(word, bits)| {
            let due = bits & occupied | !bits & empty;
            let cells = set_bits(due).map(move |bit| word as u32 * 64 + bit);
            let seen = cells.filter(|cell| self.density[*cell as usize] >= 0.0);
            seen.map(|cell| self.probe(seed, round, cell))
        });
        probes.collect()
    }

    /// Draws the point at which a cell is looked at.
    fn probe(&self, seed: u64, round: u64, cell: u32) -> Probe {
        let side = self.bits.side;
        let mut rng = random_numbers(seed, Purpose::Occupancy, round, u64::from(cell));
        let corner = [cell % side, cell / side % side, cell / side / side];
        let at = corner.map(|corner| (corner as f32 + rng.unit_f32()) / side as f32);
        Probe { cell, at }
    }

    /// Takes over the densities found at the probes and decides all bits again.
    ///
    /// `step`: the shortest step, contracted. Densities that are not finite are left out.
    pub fn update(&mut self, probes: &[Probe], found: &[f32], step: f32) {
        for (probe, found) in probes.iter().zip(found).filter(|(_, found)| found.is_finite()) {
            let density = &mut self.density[probe.cell as usize];
            let before = if *density < UNKNOWN { *density * DECAY } else { 0.0 };
            *density = before.max(*found);
        }
        let shows = OCCUPIED / step;
        let least = shows.min(self.mean_density());
        let refill = match self.refill {
            Refill::AtMean => least,
            Refill::WhereItShows => shows,
        };
        let words = self.bits.words.par_iter_mut().zip(self.density.par_chunks(64));
        words.with_min_len(WORDS).for_each(|(word, cells)| {
            let before = *word;
            let bits = cells.iter().enumerate();
            *word = bits.fold(0_u64, |word, (bit, density)| {
                let least = if before >> bit & 1 == 1 { least } else { refill };
                word | u64::from((*density >= least) & (*density >= 0.0)) << bit
            });
        });
    }

    /// Returns the mean density of the probed cells, 0 without any. It is summed in lanes of fixed parts, in
    /// the same order for any number of threads.
    fn mean_density(&self) -> f32 {
        let parts = self.density.par_chunks(64 * WORDS).map(|part| {
            let (mut sums, mut counts) = ([0.0_f64; 8], [0_u32; 8]);
            for cells in part.as_chunks::<8>().0 {
                for (lane, density) in cells.iter().enumerate() {
                    let known = (*density >= 0.0) & (*density < UNKNOWN);
                    sums[lane] += if known { f64::from(*density) } else { 0.0 };
                    counts[lane] += u32::from(known);
                }
            }
            (sums.iter().sum::<f64>(), counts.iter().sum::<u32>())
        });
        let parts = parts.collect::<Vec<_>>().into_iter();
        let (sum, count) = parts.fold((0.0, 0_u64), |(sum, count), part| {
            (sum + part.0, count + u64::from(part.1))
        });
        (sum / count.max(1) as f64) as f32
    }
}

/// Returns the places of the bits that are set, from the lowest.
fn set_bits(mut word: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let bit = word.trailing_zeros();
        word &= word.wrapping_sub(1);
        (bit < 64).then_some(bit)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Camera, Image, Pose};
    use nalgebra::Vector3;

    fn views() -> Vec<View> {
        vec![View {
            id: "v".to_owned(),
            camera: Camera::pinhole(20, 20, 10.0),
            cam_from_world: Pose {
                translation: Vector3::new(0.0, 0.0, 1.0),
                ..Pose::identity()
            },
            image: Image::from_fn(20, 20, |_, _| [9; 3]).into(),
            distances: Vec::new(),
        }]
    }

    fn frame() -> Frame {
        Frame {
            origin: [0.0; 3],
            half_side: 1.0,
            ..Frame::derive(&views(), &[])
        }
    }

    /// Returns a grid whose seen cells were all found empty, and fill where their density shows.
    fn empty() -> Occupancy {
        let mut grid = Occupancy::full(32, &frame(), &views());
        for density in grid.density.iter_mut().filter(|density| **density > 0.0) {
            *density = 0.0;
        }
        Occupancy {
            bits: Bits::new(32),
            refill: Refill::WhereItShows,
            ..grid
        }
    }

    #[test]
    fn a_grid_moved_into_a_smaller_box_keeps_what_is_occupied_and_finer() {
        let from = frame();
        let to = Frame {
            half_side: 0.25,
            ..frame()
        };
        let mut one = empty();
        // The cell from 0 to 1/8 on x and y and from 1/2 to 5/8 on z.
        let cell = (20 * 32 + 16) * 32 + 16;
        one.bits.set(cell);
        one.density[cell] = 7.0;
        let moved = one.moved(&from, &to, &views());
        assert_eq!(moved.refill, Refill::WhereItShows);
        let found: Vec<usize> = (0..32_usize.pow(3))
            .filter(|cell| moved.bits.holds(*cell as u32))
            .collect();
        // In quarters the cell goes from 0 to 1/2 and, contracted, from 2 - 1/2 to 2 - 2/5: 4 cells a side
        // and 2 deep, and those around that touch it.
        assert!((32..=6 * 6 * 4).contains(&found.len()), "{}", found.len());
        for cell in found {
            let at = [cell % 32, cell / 32 % 32, cell / 1024].map(|corner| (corner as f64 + 0.5) / 32.0);
            let world = to.outward(expand(at));
            assert!(
                (-0.07..0.2).contains(&world.x)
                    && (-0.07..0.2).contains(&world.y)
                    && (0.4..0.8).contains(&world.z),
                "{world:?}"
            );
            assert_eq!(moved.density[cell], 7.0);
        }
        // All seen and none looked at: so is all of the inner box, and nothing that the new grid does not see.
        let full = Occupancy::full(32, &from, &views()).moved(&from, &to, &views());
        let seen = Occupancy::full(32, &to, &views());
        for cell in 0..32_u32.pow(3) {
            let is_inner = [cell % 32, cell / 32 % 32, cell / 1024]
                .iter()
                .all(|at| (8..24).contains(at));
            let (moved, seen) = (full.bits.holds(cell), seen.bits.holds(cell));
            assert!(!moved || seen, "{cell}");
            assert!(!is_inner || moved == seen, "{cell}");
        }
    }

    #[test]
    fn an_empty_cell_fills_where_its_density_shows_and_not_at_the_mean() {
        let mut occupancy = empty();
        let seen = |from: usize| {
            (from..32_usize.pow(3))
                .find(|cell| occupancy.density[*cell] == 0.0)
                .unwrap()
        };
        let thin = seen(0);
        let dense = seen(thin + 1);
        let probe = |cell: usize| Probe {
            cell: cell as u32,
            at: [0.5; 3],
        };
        // Half and one and a half times what shows in a step of 0.05. The mean of all is far below either.
        let shows = OCCUPIED / 0.05;
        occupancy.update(&[probe(thin), probe(dense)], &[0.5 * shows, 1.5 * shows], 0.05);
        assert!(!occupancy.bits.holds(thin as u32) && occupancy.bits.holds(dense as u32));
        let mut full = Occupancy::full(32, &frame(), &views());
        full.density
            .iter_mut()
            .filter(|density| **density > 0.0)
            .for_each(|density| *density = 0.0);
        full.update(&[probe(thin)], &[0.5 * shows], 0.05);
        assert!(full.bits.holds(thin as u32));
    }
}
