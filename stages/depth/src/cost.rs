//! What it costs to match a pixel at each of its candidates: the Hamming distance of two census codes.

use marf_numeric::InstructionSet;
use rayon::prelude::*;

use crate::kernel::{self, Kernel};
use crate::raster::{Picture, Raster};

/// Candidates in a block that is computed at once.
pub(crate) const BLOCK: usize = 32;

/// Half the height and half the width of the window of a census code: 7 rows of 9 pixels, 62 comparisons.
const CENSUS_ROWS: usize = 3;
const CENSUS_COLUMNS: usize = 4;

/// The largest cost.
pub(crate) const COST_MAX: u8 = 62;

/// The cost where there is nothing to compare with: outside the other picture, or masked.
const COST_UNKNOWN: u8 = 24;

/// Costs of all candidates of all pixels.
#[derive(Debug)]
pub(crate) struct Volume {
    pub width: usize,
    pub height: usize,
    /// Candidates a pixel, a multiple of [`BLOCK`].
    pub candidates: usize,
    /// The disparity of the first candidate of each pixel. The others follow in steps of one pixel.
    pub first: Raster<i32>,
    /// `[height x width x candidates]`, 0 to [`COST_MAX`].
    pub costs: Vec<u8>,
    /// Where the whole window of a census code takes part, left and right. Elsewhere its bits are those of the border of a mask.
    pub usable: [Raster<bool>; 2],
}

impl Volume {
    /// Compares each pixel of `left` with those of `right` at its candidates: x in left is x - disparity in right.
    pub fn new(set: InstructionSet, pair: [&Picture; 2], first: Raster<i32>, candidates: usize) -> Self {
        let [left, right] = pair.map(|picture| census(set, &picture.grey));
        let usable = pair.map(|picture| picture.usable.eroded(CENSUS_COLUMNS, CENSUS_ROWS));
        let (width, height) = (left.width, left.height);
        let mut costs = vec![0; width * height * candidates];
        costs
            .par_chunks_mut((width * candidates).max(1))
            .enumerate()
            .for_each(|(y, costs)| {
                let other = Mirrored::new(right.row(y), usable[1].row(y), candidates);
                let usable = usable[0].row(y);
                kernel::run(
                    set,
                    CostRow {
                        codes: left.row(y),
                        usable,
                        first: first.row(y),
                        other,
                        costs,
                    },
                );
            });
        Self {
            width,
            height,
            candidates,
            first,
            costs,
            usable,
        }
    }
}

/// Returns the census code of each pixel: one bit for each pixel of a 9 x 7 window, set where it is darker than the
/// centre (Zabih and Woodfill, ECCV 1994). It changes neither with gain nor with offset.
fn census(set: InstructionSet, grey: &Raster<u8>) -> Raster<u64> {
    let padded = grey.padded(CENSUS_COLUMNS);
    let mut codes = Raster::like(grey, 0);
    codes
        .values
        .par_chunks_mut(grey.width)
        .enumerate()
        .for_each(|(y, codes)| {
            kernel::run(
                set,
                CensusRow {
                    padded: &padded,
                    y: y + CENSUS_COLUMNS,
                    codes,
                },
            );
        });
    codes
}

struct CensusRow<'a> {
    padded: &'a Raster<u8>,
    y: usize,
    codes: &'a mut [u64],
}

impl Kernel for CensusRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let width = self.codes.len();
        let centre = &self.padded.row(self.y)[CENSUS_COLUMNS..CENSUS_COLUMNS + width];
        for row in self.y - CENSUS_ROWS..=self.y + CENSUS_ROWS {
            for column in 0..=2 * CENSUS_COLUMNS {
                if row == self.y && column == CENSUS_COLUMNS {
                    continue;
                }
                let values = &self.padded.row(row)[column..column + width];
                for ((code, value), centre) in self.codes.iter_mut().zip(values).zip(centre) {
                    *code = (*code << 1) | u64::from(value < centre);
                }
            }
        }
    }
}

/// A row of the other picture from right to left, so that growing disparities are next to each other.
struct Mirrored {
    codes: Vec<u64>,
    /// 0 where there is something to compare with, 255 elsewhere.
    unknown: Vec<u8>,
    margin: usize,
}

impl Mirrored {
    fn new(codes: &[u64], usable: &[bool], candidates: usize) -> Self {
        let mut row = Self {
            codes: vec![0; codes.len() + 2 * candidates],
            unknown: vec![255; codes.len() + 2 * candidates],
            margin: candidates,
        };
        for (x, (code, usable)) in codes.iter().zip(usable).enumerate() {
            let at = candidates + codes.len() - 1 - x;
            row.codes[at] = *code;
            row.unknown[at] = if *usable { 0 } else { 255 };
        }
        row
    }

    /// Returns where the counterpart of `x` at `disparity` is. What is outside is unknown, wherever it is.
    #[inline(always)]
    fn place(&self, x: usize, disparity: i32) -> usize {
        let last = (self.codes.len() - self.margin) as i64;
        let at = last - 1 - x as i64 + i64::from(disparity);
        at.clamp(0, last) as usize
    }
}

struct CostRow<'a> {
    codes: &'a [u64],
    usable: &'a [bool],
    first: &'a [i32],
    other: Mirrored,
    costs: &'a mut [u8],
}

impl Kernel for CostRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let candidates = self.other.margin;
        for (x, costs) in self.costs.chunks_exact_mut(candidates).enumerate() {
            if !self.usable[x] {
                costs.fill(COST_UNKNOWN);
                continue;
            }
            let at = self.other.place(x, self.first[x]);
            let code = self.codes[x];
            let codes = &self.other.codes[at..at + candidates];
            let unknown = &self.other.unknown[at..at + candidates];
            let (costs, _) = costs.as_chunks_mut::<BLOCK>();
            let (codes, _) = codes.as_chunks::<BLOCK>();
            let (unknown, _) = unknown.as_chunks::<BLOCK>();
            for ((costs, codes), unknown) in costs.iter_mut().zip(codes).zip(unknown) {
                for i in 0..BLOCK {
                    let bits = (code ^ codes[i]).count_ones() as u8;
                    costs[i] = (bits & !unknown[i]) | (COST_UNKNOWN & unknown[i]);
                }
            }
        }
    }
}
