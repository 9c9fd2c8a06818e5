//! Nearest and second nearest descriptor in both directions, in one pass over all dot products.

use crate::simd::{self, COLUMNS, ColumnBlock, InstructionSet, Kernel, Lanes, ROWS, RowBlock};

/// The two greatest dot products of a descriptor with those of the other photo.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NearestTwo {
    pub best: i32,
    /// 0, the smallest possible, where the other photo has only one descriptor.
    pub second: i32,
    /// Index of the best, the lowest on ties.
    pub index: u32,
}

/// Descriptors laid out as columns of dot products.
pub(super) struct ColumnBlocks {
    len: usize,
    blocks: Vec<ColumnBlock>,
}

impl ColumnBlocks {
    pub(super) fn new(descriptors: &[[u8; 128]]) -> Self {
        Self {
            len: descriptors.len(),
            blocks: descriptors.chunks(COLUMNS).map(ColumnBlock::new).collect(),
        }
    }
}

/// Returns the nearest column of every row and the nearest row of every column. Empty if a side is empty.
///
/// Missing rows and columns of the last blocks are zero: their dot product 0 comes after every real one, so it
/// is never the nearest and changes no second nearest.
pub(super) fn nearest(
    set: InstructionSet,
    rows: &[[u8; 128]],
    columns: &ColumnBlocks,
) -> (Vec<NearestTwo>, Vec<NearestTwo>) {
    if rows.is_empty() || columns.len == 0 {
        return (Vec::new(), Vec::new());
    }
    simd::run(set, Search { rows, columns })
}

/// The two greatest dot products in each of sixteen independent lanes.
#[derive(Clone, Copy)]
struct GreatestTwo {
    best: [i32; COLUMNS],
    second: [i32; COLUMNS],
    index: [u32; COLUMNS],
}

impl GreatestTwo {
    const NONE: Self = Self {
        best: [-1; COLUMNS],
        second: [-1; COLUMNS],
        index: [0; COLUMNS],
    };

    /// Updates every lane with a dot product and its index.
    #[inline(always)]
    fn update(&mut self, dots: &[i32; COLUMNS], index: u32) {
        let lanes = self.best.iter_mut().zip(&mut self.second).zip(&mut self.index);
        for (((best, second), index_of), &dot) in lanes.zip(dots) {
            *second = (*second).max(dot.min(*best));
            *index_of = if dot > *best { index } else { *index_of };
            *best = (*best).max(dot);
        }
    }

    /// Returns the two greatest of one lane.
    fn lane(&self, lane: usize) -> NearestTwo {
        NearestTwo {
            best: self.best[lane],
            second: self.second[lane].max(0),
            index: self.index[lane],
        }
    }

    /// Returns the two greatest of all lanes. The lanes' indices are those of blocks of columns.
    fn across(&self) -> NearestTwo {
        let column = |lane: usize| self.index[lane] * COLUMNS as u32 + lane as u32;
        let mut near = NearestTwo {
            index: column(0),
            ..self.lane(0)
        };
        for lane in 1..COLUMNS {
            let (best, index) = (self.best[lane], column(lane));
            near.second = near.second.max(self.second[lane]).max(best.min(near.best));
            if best > near.best || (best == near.best && index < near.index) {
                (near.best, near.index) = (best, index);
            }
        }
        near
    }
}

/// The search for nearest neighbours as a kernel.
struct Search<'a> {
    rows: &'a [[u8; 128]],
    columns: &'a ColumnBlocks,
}

impl Kernel for Search<'_> {
    type Output = (Vec<NearestTwo>, Vec<NearestTwo>);

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let mut by_column = vec![GreatestTwo::NONE; self.columns.blocks.len()];
        let mut rows = Vec::with_capacity(self.rows.len());
        for (descriptors, first) in self.rows.chunks(ROWS).zip((0_u32..).step_by(ROWS)) {
            let block = RowBlock::new(descriptors);
            let mut by_row = [GreatestTwo::NONE; ROWS];
            for ((columns, down), at) in self.columns.blocks.iter().zip(&mut by_column).zip(0..) {
                let dots = lanes.dots(&block, columns);
                for ((dots, across), row) in dots.iter().zip(&mut by_row).zip(first..) {
                    across.update(dots, at);
                    down.update(dots, row);
                }
            }
            rows.extend(by_row.iter().take(descriptors.len()).map(GreatestTwo::across));
        }
        let columns = (0..self.columns.len).map(|index| by_column[index / COLUMNS].lane(index % COLUMNS));
        (rows, columns.collect())
    }
}
