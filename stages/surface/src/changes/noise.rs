//! Mean of the trainings of one time, cell by cell, and their differences.

use super::cells::{Extent, Grid, Values, around};

/// Cells to each side over which variances are averaged: of three trainings alone a variance is hardly known.
const POOLED: i64 = 2;
/// Half width of 90 % of a normal distribution, standard deviations.
pub(super) const NINETY: f64 = 1.644_85;
/// Share of a cell by which two maps may be shifted against each other.
const BESIDE: f64 = 0.25;

/// Mean and variance of a cell over the trainings of a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    pub mean: Values,
    pub variance: Values,
    /// Mean square of how far the views of a field differ in height, square metres.
    pub spread_m2: f64,
}

/// The ground at one time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Ground {
    pub cells: Vec<Option<Cell>>,
}

impl Ground {
    /// Combines maps of one time on the cells of an extent. A cell is known where all but a quarter of the maps, and
    /// at least two, have it.
    pub fn new(extent: &Extent, members: &[Grid]) -> Self {
        let mut sums = vec![(0_u32, [0.0; 4], [0.0; 4], 0.0); extent.cells()];
        for member in members {
            for row in 0..member.extent.rows {
                for column in 0..member.extent.columns {
                    let own = row as usize * member.extent.columns as usize + column as usize;
                    let Some(values) = member.values[own] else {
                        continue;
                    };
                    let Some(place) = extent.place(&member.extent, column, row) else {
                        continue;
                    };
                    let (count, mean, squares, spread) = &mut sums[place];
                    *count += 1;
                    *spread += member.spread_m[own] * member.spread_m[own];
                    // Welford's update.
                    for quantity in 0..4 {
                        let before = values[quantity] - mean[quantity];
                        mean[quantity] += before / f64::from(*count);
                        squares[quantity] += before * (values[quantity] - mean[quantity]);
                    }
                }
            }
        }
        let is_enough = |count: u32| count >= 2 && 4 * count as usize >= 3 * members.len();
        let cells = sums.into_iter().map(|(count, mean, squares, spread)| {
            is_enough(count).then(|| Cell {
                mean,
                variance: squares.map(|sum| sum / f64::from(count - 1)),
                spread_m2: spread / f64::from(count),
            })
        });
        Self {
            cells: cells.collect(),
        }
    }

    /// Returns the variance that counts in each cell: the means around it of how far trainings and views differ, and what a quarter of a
    /// cell to the side changes.
    pub fn variances(&self, extent: &Extent) -> Vec<Option<Values>> {
        let places = 0..self.cells.len();
        let variance = |place: usize| {
            let own = self.cells[place]?;
            let mut pooled = [0.0; 4];
            let mut count = 0.0;
            for cell in around(extent, place, POOLED).filter_map(|near| self.cells[near]) {
                count += 1.0;
                (0..4).for_each(|quantity| pooled[quantity] += cell.variance[quantity]);
                pooled[0] += cell.spread_m2;
            }
            let mut steepest: Values = [0.0; 4];
            for cell in around(extent, place, 1).filter_map(|near| self.cells[near]) {
                steepest = [0, 1, 2, 3].map(|quantity| {
                    let step = (cell.mean[quantity] - own.mean[quantity]).abs();
                    step.max(steepest[quantity])
                });
            }
            Some([0, 1, 2, 3].map(|quantity| {
                let beside = BESIDE * steepest[quantity];
                pooled[quantity] / count + beside * beside
            }))
        };
        places.map(variance).collect()
    }
}
