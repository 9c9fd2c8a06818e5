//! The ground at two times, compared cell by cell.

use marf_numeric::{quantile, upper_median};
use marf_schema::changes::{Change, ChangesParams, ChangesReport, Noise, Patch, Registration, Time};
use marf_stage::StageError;
use nalgebra::{Matrix3, Vector3};

use crate::frame::{ExportFrame, MapAxes};

use super::cells::{Extent, Grid, Values, around};
use super::noise::{Ground, NINETY};
use super::patches::{CellChange, PatchCells, Patches, patches};

/// Fewest cells that both times show.
const LEAST_COMMON: usize = 400;
/// Cells of the maps around the ground that both times show.
const MARGIN: i64 = 10;
/// Median of how far a normal distribution is off, standard deviations.
const MEDIAN: f64 = 0.674_49;
/// Share of the limit beyond which a cell is part of a patch that others have begun.
const WEAK: f64 = 2.0 / 3.0;
/// Share of the ground that is taken for unchanged.
const UNCHANGED: f64 = 0.9;
/// Least factor from how far trainings and views differ to the noise: it is never taken for less.
const LEAST_FACTOR: f64 = 1.0;
/// Cells to each side of a cell that are checked for a surface at both times, and how many of all must have
/// one: surfaces bend at the edge of what photos saw.
const EDGE: i64 = 2;
const LEAST_AROUND: usize = 20;
/// Beyond this many standard deviations a cell is not part of a plane (Tukey's biweight).
const TUKEY: f64 = 4.685;
/// Rounds of the fit of a plane.
const ROUNDS: usize = 12;
/// A factor of the light from which on the cause may be a shadow. A shadow keeps half of the light of the
/// open Martian ground or less (the sky gives a third to a half of all light at an optical depth of 0.5).
const SHADOW: f64 = 0.6;
/// Least standard deviations: a millimetre, which is the step of heights, and a gray level of the photos.
const FLOORS: Values = [0.001, 0.01, 0.01, 0.01];
const HEIGHT: usize = 0;
const BRIGHTNESS: usize = 1;
const RED: usize = 2;
const BLUE: usize = 3;

/// A cell that both times show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CellDifference {
    /// Later less earlier, without what the two times differ by as a whole.
    pub difference: Values,
    /// Standard deviation of that where nothing has changed.
    pub sigma: Values,
}

impl CellDifference {
    fn off(&self, quantity: usize) -> f64 {
        (self.difference[quantity] / self.sigma[quantity]).abs()
    }

    /// Returns what changed, if it differs by more than `sigmas` standard deviations.
    fn change(&self, sigmas: f64) -> Option<Change> {
        if self.off(HEIGHT) > sigmas {
            return Some(if self.difference[HEIGHT] > 0.0 {
                Change::Higher
            } else {
                Change::Lower
            });
        }
        let is_coloured = self.off(RED).max(self.off(BLUE)) > sigmas;
        if is_coloured && self.difference[BRIGHTNESS].abs() < -libm::log(SHADOW) {
            return Some(Change::Colour);
        }
        (is_coloured || self.off(BRIGHTNESS) > sigmas).then_some(Change::Undecided)
    }
}

/// Two times on one grid.
pub(super) struct Comparison {
    pub extent: Extent,
    pub cell_m: f64,
    pub before: Ground,
    pub after: Ground,
    pub cells: Vec<Option<CellDifference>>,
    pub patches: Patches,
    registration: Registration,
    noise: [Noise; 3],
}

impl Comparison {
    /// Compares the maps of two times.
    ///
    /// # Errors
    /// Too little ground that both show.
    pub fn new(before: &[Grid], after: &[Grid], params: &ChangesParams) -> Result<Self, StageError> {
        let extents = || before.iter().chain(after).map(|grid| grid.extent);
        let (Some(widest), Some(grid)) = (extents().reduce(Extent::with), before.first()) else {
            return Err(StageError::new("there is no surface to compare"));
        };
        let cell_m = grid.cell_m;
        let common = common(&Ground::new(&widest, before), &Ground::new(&widest, after));
        let extent = widest.around(common.iter().copied(), MARGIN);
        let Some(extent) = extent.filter(|_| common.len() >= LEAST_COMMON) else {
            return Err(StageError::new(format!(
                "both times show {} cells of {cell_m} m of the same ground, {LEAST_COMMON} are needed",
                common.len()
            ))
            .hint("compare sols whose photos look at one place, or take longer trainings"));
        };
        let (earlier, later) = (Ground::new(&extent, before), Ground::new(&extent, after));
        let mut cells = differences(&extent, &earlier, &later);
        let registration = register(&extent, cell_m, &mut cells);
        let noise = scale(&mut cells);
        let found = cells.iter().map(|cell| {
            let cell = cell.as_ref()?;
            let [_, _, red, blue] = cell.difference;
            Some(CellChange {
                strong: cell.change(params.sigmas),
                weak: cell.change(WEAK * params.sigmas),
                colour: (red * red + blue * blue).sqrt(),
            })
        });
        let patches = patches(&extent, &found.collect::<Vec<_>>(), params.least_cells as usize);
        Ok(Self {
            extent,
            cell_m,
            before: earlier,
            after: later,
            cells,
            patches,
            registration,
            noise,
        })
    }

    /// Returns the report.
    pub fn report(&self, frame: &ExportFrame, axes: &MapAxes, [before, after]: [Time; 2]) -> ChangesReport {
        let cell_m2 = self.cell_m * self.cell_m;
        let area = |cells: usize| cells as f64 * cell_m2;
        let shown = |ground: &Ground| area(ground.cells.iter().flatten().count());
        let patches = self
            .patches
            .list
            .iter()
            .map(|patch| self.patch(patch))
            .collect::<Vec<_>>();
        let area_where = |is: &dyn Fn(Change) -> bool| {
            let all = patches.iter().filter(|patch| is(patch.change));
            // The sum of no number is -0.
            all.map(|patch| patch.area_m2).fold(0.0, |sum, area| sum + area)
        };
        ChangesReport {
            before: Time {
                area_m2: shown(&self.before),
                ..before
            },
            after: Time {
                area_m2: shown(&self.after),
                ..after
            },
            cell_m: self.cell_m,
            size: [self.extent.columns, self.extent.rows],
            first_m: [self.across_m(0), self.up_m(0)],
            axes: [axes.right, axes.top, axes.up].map(Into::into),
            origin: frame.origin_words(),
            compared_m2: area(self.cells.iter().flatten().count()),
            changed_m2: area_where(&|change| change != Change::Undecided),
            undecided_m2: area_where(&|change| change == Change::Undecided),
            registration: self.registration,
            height: self.noise[0],
            brightness: self.noise[1],
            colour: self.noise[2],
            patches,
        }
    }

    /// Returns the report of a patch.
    fn patch(&self, patch: &PatchCells) -> Patch {
        let cell_m2 = self.cell_m * self.cell_m;
        let area = |cells: usize| cells as f64 * cell_m2;
        let count = patch.cells.len() as f64;
        let mean =
            |value: &dyn Fn(usize) -> f64| patch.cells.iter().map(|place| value(*place)).sum::<f64>() / count;
        let difference =
            |quantity: usize| mean(&|place| self.cells[place].map_or(0.0, |cell| cell.difference[quantity]));
        let interval_m = mean(&|place| self.cells[place].map_or(0.0, |cell| cell.sigma[0] * NINETY));
        let height_m = difference(0);
        Patch {
            change: patch.change,
            area_m2: area(patch.cells.len()),
            area_interval_m2: [area(patch.strong), area(patch.widened)],
            middle_m: [
                mean(&|place| self.across_m(place)),
                mean(&|place| self.up_m(place)),
            ],
            height_m: [height_m, interval_m],
            volume_m3: height_m * area(patch.cells.len()),
            brightness: libm::exp(difference(1)),
        }
    }

    /// Returns the world file of all maps (ESRI): six lines, pixel to metres on the map.
    pub fn world_file(&self) -> String {
        let cell = self.cell_m;
        format!(
            "{cell}\n0\n0\n{}\n{}\n{}\n",
            -cell,
            self.across_m(0),
            self.up_m(0)
        )
    }

    /// Returns how far to the right of the map's origin the middle of a cell is, metres.
    pub fn across_m(&self, place: usize) -> f64 {
        let column = (place % self.extent.columns as usize) as i64;
        ((self.extent.left + column) as f64 + 0.5) * self.cell_m
    }

    /// Returns how far to the top of the map's origin the middle of a cell is, metres.
    pub fn up_m(&self, place: usize) -> f64 {
        let row = (place / self.extent.columns as usize) as i64;
        ((self.extent.top - row) as f64 + 0.5) * self.cell_m
    }
}

/// Returns the places of the cells that both times show.
fn common(before: &Ground, after: &Ground) -> Vec<usize> {
    let both = before.cells.iter().zip(&after.cells);
    let shown = both.map(|(before, after)| before.is_some() && after.is_some());
    shown
        .enumerate()
        .filter_map(|(place, shown)| shown.then_some(place))
        .collect()
}

/// Returns the differences of the cells that both times show with most around them, with the standard deviations of the trainings.
fn differences(extent: &Extent, before: &Ground, after: &Ground) -> Vec<Option<CellDifference>> {
    let (earlier, later) = (before.variances(extent), after.variances(extent));
    let cells = before
        .cells
        .iter()
        .zip(&after.cells)
        .zip(earlier.iter().zip(&later));
    let is_shown = |place: &usize| before.cells[*place].is_some() && after.cells[*place].is_some();
    let compared = cells
        .enumerate()
        .map(|(place, ((before, after), (earlier, later)))| {
            let (before, after, earlier, later) = ((*before)?, (*after)?, (*earlier)?, (*later)?);
            if around(extent, place, EDGE).filter(is_shown).count() < LEAST_AROUND {
                return None;
            }
            Some(CellDifference {
                difference: [0, 1, 2, 3].map(|quantity| after.mean[quantity] - before.mean[quantity]),
                sigma: [0, 1, 2, 3].map(|quantity| {
                    let floor = FLOORS[quantity];
                    (earlier[quantity] + later[quantity] + floor * floor).sqrt()
                }),
            })
        });
    compared.collect()
}

/// Takes away what the two times differ by as a whole: a plane of the height, and factors of the light.
fn register(extent: &Extent, cell_m: f64, cells: &mut [Option<CellDifference>]) -> Registration {
    let middle = (f64::from(extent.columns) / 2.0, f64::from(extent.rows) / 2.0);
    let place = |index: usize| {
        let (column, row) = (index % extent.columns as usize, index / extent.columns as usize);
        Vector3::new(
            1.0,
            (column as f64 + 0.5 - middle.0) * cell_m,
            (middle.1 - row as f64 - 0.5) * cell_m,
        )
    };
    let heights: Vec<(Vector3<f64>, f64)> = cells
        .iter()
        .enumerate()
        .filter_map(|(index, cell)| Some((place(index), cell.as_ref()?.difference[HEIGHT])))
        .collect();
    let plane = plane(&heights);
    let light = [BRIGHTNESS, RED, BLUE].map(|quantity| {
        let known = cells.iter().flatten().map(|cell| cell.difference[quantity]);
        upper_median(known).unwrap_or(0.0)
    });
    for (index, cell) in cells.iter_mut().enumerate() {
        let Some(cell) = cell else { continue };
        cell.difference[HEIGHT] -= plane.dot(&place(index));
        for (quantity, light) in [BRIGHTNESS, RED, BLUE].into_iter().zip(light) {
            cell.difference[quantity] -= light;
        }
    }
    Registration {
        offset_m: plane.x,
        tilt: [plane.y, plane.z],
        gain: [light[0] + light[1], light[0], light[0] + light[2]].map(libm::exp),
    }
}

/// Fits value = p · place to most of the cells: least squares with Tukey's biweight, from the median on.
fn plane(cells: &[(Vector3<f64>, f64)]) -> Vector3<f64> {
    let middle = upper_median(cells.iter().map(|(_, value)| *value)).unwrap_or(0.0);
    let mut plane = Vector3::new(middle, 0.0, 0.0);
    for _ in 0..ROUNDS {
        let off: Vec<f64> = cells
            .iter()
            .map(|(place, value)| (value - plane.dot(place)).abs())
            .collect();
        let median = upper_median(off.iter().copied()).unwrap_or(0.0);
        let reach = TUKEY * (median / MEDIAN).max(1e-9);
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for ((place, value), off) in cells.iter().zip(&off) {
            let share = (1.0 - (off / reach) * (off / reach)).max(0.0);
            let weight = share * share;
            normal += place * place.transpose() * weight;
            right += place * (weight * value);
        }
        match normal.cholesky() {
            Some(solved) => plane = solved.solve(&right),
            // All cells on one line: the offset alone is known.
            None => return plane,
        }
    }
    plane
}

/// Scales the standard deviations so that they hold what they should of the ground, which is taken for unchanged, and returns the noise of
/// height, brightness and colour.
fn scale(cells: &mut [Option<CellDifference>]) -> [Noise; 3] {
    let quantities: [&[usize]; 3] = [&[HEIGHT], &[BRIGHTNESS], &[RED, BLUE]];
    quantities.map(|quantities| {
        let factor = quantities
            .iter()
            .map(|quantity| {
                let off = cells.iter().flatten().map(|cell| cell.off(*quantity));
                quantile(off, UNCHANGED).unwrap_or(0.0) / NINETY
            })
            .fold(LEAST_FACTOR, f64::max);
        for cell in cells.iter_mut().flatten() {
            quantities
                .iter()
                .for_each(|quantity| cell.sigma[*quantity] *= factor);
        }
        let intervals = quantities.iter().map(|quantity| {
            let sigmas = cells.iter().flatten().map(|cell| cell.sigma[*quantity] * NINETY);
            upper_median(sigmas).unwrap_or(0.0)
        });
        Noise {
            interval: intervals.fold(0.0, f64::max),
            factor,
        }
    })
}
