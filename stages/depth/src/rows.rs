//! Where the rows of the right picture of a pair are, from what both pictures show. Labels are off by some pixels.

use marf_schema::depth::RowOffset;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::raster::{Picture, Raster};
use crate::search::Search;

/// Patches are looked for in pictures of at most this width, and then followed to the full size.
const COARSE_WIDTH: usize = 256;
/// Rows above and below that are tried at that width.
const ROWS: i32 = 8;
/// Places to each side that are tried at each finer size.
const FINE: i32 = 2;
/// Half the width of a patch.
const RADIUS: i32 = 5;
/// Patches in a row and in a column: one in each cell of a grid.
const CELLS: [usize; 2] = [16, 12];
/// Least correlation of a match.
const LEAST_LIKENESS: f64 = 0.75;
/// Least difference to the best match elsewhere.
const LEAST_LEAD: f64 = 0.05;
/// Least variance of the brightness of a patch.
const LEAST_VARIANCE: f64 = 4.0;
/// Fewest matches of a fit, and their least share of all matches.
const FEWEST: usize = 24;
const LEAST_SHARE: f64 = 0.5;
/// Matches within this of the fit decide it, in pixels: of the first round, and of the others.
const REACH_PX: [f64; 4] = [4.0, 2.0, 1.0, 1.0];
/// A fit that moves the matches by less, in their root mean square, does no good: it would follow their noise.
const HARMLESS_PX: f64 = 0.25;

/// Finds how far the rows of the right picture are from those of the left one. `None` if it is harmless or if too few matches agree.
///
/// In each cell of a grid, the patch with most texture is looked for by normalised correlation, up and down as well as along the row. The plane
/// through the differences of the rows is fitted to those near it.
pub(crate) fn row_offset(left: &Picture, right: &Picture, search: Search) -> Option<RowOffset> {
    let (width, height) = (left.grey.width as f64, left.grey.height as f64);
    let matches = matches(left, right, search);
    fit(&matches, [width, height])
}

/// A patch of the left picture, and where the right one shows it.
#[derive(Debug, Clone, Copy)]
struct PatchMatch {
    x: i32,
    y: i32,
    disparity: i32,
    /// How many rows below.
    row: f64,
}

fn matches(left: &Picture, right: &Picture, search: Search) -> Vec<PatchMatch> {
    if left.grey.width <= COARSE_WIDTH {
        let patches = patches(left);
        let rows = -ROWS..=ROWS;
        let found = patches.par_iter().filter_map(|&[x, y]| {
            let columns = search.first..=search.last();
            best(left, right, [x, y], columns, rows.clone())
        });
        return found.collect();
    }
    let coarse = matches(&left.halved(), &right.halved(), search.halved());
    let finer = coarse.par_iter().filter_map(|coarse| {
        let (disparity, row) = (2 * coarse.disparity, 2 * coarse.row.round() as i32);
        let columns = disparity - FINE..=disparity + FINE;
        best(
            left,
            right,
            [2 * coarse.x, 2 * coarse.y],
            columns,
            row - FINE..=row + FINE,
        )
    });
    finer.collect()
}

/// Returns the pixel with most texture of each cell.
fn patches(picture: &Picture) -> Vec<[i32; 2]> {
    let (width, height) = (picture.grey.width, picture.grey.height);
    let mut all = Vec::new();
    for cell in 0..CELLS[0] * CELLS[1] {
        let [i, j] = [cell % CELLS[0], cell / CELLS[0]];
        let columns = i * width / CELLS[0]..(i + 1) * width / CELLS[0];
        let mut most = None;
        for y in j * height / CELLS[1]..(j + 1) * height / CELLS[1] {
            for x in columns.clone() {
                let at = [x as i32, y as i32];
                let Some(patch) = Patch::new(picture, at) else {
                    continue;
                };
                if patch.variance() > most.map_or(LEAST_VARIANCE, |(variance, _)| variance) {
                    most = Some((patch.variance(), at));
                }
            }
        }
        all.extend(most.map(|(_, at)| at));
    }
    all
}

const SIDE: usize = 2 * RADIUS as usize + 1;

/// A square of pixels that all take part.
struct Patch<'a> {
    grey: &'a Raster<u8>,
    /// The first pixel.
    start: usize,
    sum: i64,
    squares: i64,
}

impl<'a> Patch<'a> {
    fn new(picture: &'a Picture, [x, y]: [i32; 2]) -> Option<Self> {
        let (width, height) = (picture.grey.width as i32, picture.grey.height as i32);
        if x < RADIUS || y < RADIUS || x + RADIUS >= width || y + RADIUS >= height {
            return None;
        }
        let start = ((y - RADIUS) * width + x - RADIUS) as usize;
        let (mut sum, mut squares) = (0, 0);
        for row in 0..SIDE {
            let at = start + row * width as usize;
            if picture.usable.values[at..at + SIDE].contains(&false) {
                return None;
            }
            for value in &picture.grey.values[at..at + SIDE] {
                sum += i64::from(*value);
                squares += i64::from(*value) * i64::from(*value);
            }
        }
        Some(Self {
            grey: &picture.grey,
            start,
            sum,
            squares,
        })
    }

    /// The sum of squared differences to the mean, times the number of pixels.
    fn scatter(&self) -> i64 {
        (SIDE * SIDE) as i64 * self.squares - self.sum * self.sum
    }

    fn variance(&self) -> f64 {
        self.scatter() as f64 / (SIDE * SIDE * SIDE * SIDE) as f64
    }

    /// Normalised correlation, in [-1, 1].
    fn likeness(&self, other: &Self) -> f64 {
        let mut products = 0i64;
        for row in 0..SIDE {
            let rows = [self, other].map(|one| {
                let at = one.start + row * one.grey.width;
                &one.grey.values[at..at + SIDE]
            });
            let of_row: u32 = rows[0]
                .iter()
                .zip(rows[1])
                .map(|(a, b)| u32::from(*a) * u32::from(*b))
                .sum();
            products += i64::from(of_row);
        }
        let covariance = (SIDE * SIDE) as i64 * products - self.sum * other.sum;
        let scale = (self.scatter() as f64 * other.scatter() as f64).sqrt();
        if scale > 0.0 {
            covariance as f64 / scale
        } else {
            0.0
        }
    }
}

/// Returns the best match of a patch, unless another one is about as good or the best is at the border of the search.
fn best(
    left: &Picture,
    right: &Picture,
    [x, y]: [i32; 2],
    columns: std::ops::RangeInclusive<i32>,
    rows: std::ops::RangeInclusive<i32>,
) -> Option<PatchMatch> {
    let patch = Patch::new(left, [x, y])?;
    let likeness = |disparity: i32, row: i32| {
        Patch::new(right, [x - disparity, y + row]).map_or(-1.0, |other| patch.likeness(&other))
    };
    let mut all = Vec::new();
    for row in rows.clone() {
        for disparity in columns.clone() {
            all.push((likeness(disparity, row), disparity, row));
        }
    }
    let (most, disparity, row) = all.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0))?;
    let rival = all
        .iter()
        .filter(|(_, d, r)| (d - disparity).abs() > 2 || (r - row).abs() > 2);
    let rival = rival.map(|(likeness, ..)| *likeness).fold(-1.0, f64::max);
    let at_border = row == *rows.start() || row == *rows.end();
    if most < LEAST_LIKENESS || rival > most - LEAST_LEAD || at_border {
        return None;
    }
    let (above, below) = (likeness(disparity, row - 1), likeness(disparity, row + 1));
    let bend = 2.0 * most - above - below;
    let fraction = if bend > 0.0 {
        (below - above) / (2.0 * bend)
    } else {
        0.0
    };
    Some(PatchMatch {
        x,
        y,
        disparity,
        row: f64::from(row) + fraction.clamp(-0.5, 0.5),
    })
}

/// Fits a plane to the rows of the matches that are near it.
fn fit(matches: &[PatchMatch], [width, height]: [f64; 2]) -> Option<RowOffset> {
    let at = |one: &PatchMatch| {
        let (x, y) = (f64::from(one.x - one.disparity) + 0.5, f64::from(one.y) + 0.5);
        Vector3::new(1.0, x - width / 2.0, y - height / 2.0)
    };
    let middle = marf_numeric::upper_median(matches.iter().map(|one| one.row))?;
    let mut plane = Vector3::new(middle, 0.0, 0.0);
    let off = |plane: &Vector3<f64>, one: &PatchMatch| one.row - plane.dot(&at(one));
    for reach in REACH_PX {
        // Slopes of few matches near each other are held down: a hundredth of a picture's spread.
        let mut normal = Matrix3::from_diagonal(&Vector3::new(0.0, width * width, height * height)) * 0.01;
        let mut sum = Vector3::zeros();
        for one in matches.iter().filter(|one| off(&plane, one).abs() <= reach) {
            let at = at(one);
            normal += at * at.transpose();
            sum += at * one.row;
        }
        plane = normal.try_inverse()? * sum;
    }
    let reach = REACH_PX[REACH_PX.len() - 1];
    let near: Vec<&PatchMatch> = matches
        .iter()
        .filter(|one| off(&plane, one).abs() <= reach)
        .collect();
    if near.len() < FEWEST || (near.len() as f64) < LEAST_SHARE * matches.len() as f64 {
        return None;
    }
    let rms = |of: &dyn Fn(&PatchMatch) -> f64| {
        let squares: f64 = near.iter().map(|one| of(one).powi(2)).sum();
        (squares / near.len() as f64).sqrt()
    };
    if rms(&|one| plane.dot(&at(one))) <= HARMLESS_PX {
        return None;
    }
    Some(RowOffset {
        offset_px: plane.x,
        slope_x: plane.y,
        slope_y: plane.z,
        matches: near.len() as u32,
        rms_px: rms(&|one| off(&plane, one)),
    })
}

#[cfg(test)]
mod tests {
    use marf_numeric::mix;

    use super::*;

    /// Smooth noise of 3 px.
    fn brightness(x: f64, y: f64) -> f64 {
        let corner = |x: f64, y: f64| {
            let seed = (x as i64 as u64).wrapping_mul(0x9e37) ^ (y as i64 as u64) << 32;
            (mix(seed) >> 56) as f64
        };
        let (x, y) = (x / 3.0, y / 3.0);
        let (i, j) = (x.floor(), y.floor());
        let (u, v) = (x - i, y - j);
        let top = corner(i, j) * (1.0 - u) + corner(i + 1.0, j) * u;
        let bottom = corner(i, j + 1.0) * (1.0 - u) + corner(i + 1.0, j + 1.0) * u;
        top * (1.0 - v) + bottom * v
    }

    fn picture(value: impl Fn(f64, f64) -> f64) -> Picture {
        let values = (0..320 * 200).map(|i| value((i % 320) as f64, (i / 320) as f64).round() as u8);
        Picture::new(Raster {
            width: 320,
            height: 200,
            values: values.collect(),
        })
    }

    /// The right picture shows in the row y + offset + slope x what the left one shows in the row y, 12 px to the left.
    fn moved(offset: f64, slope: f64) -> [Picture; 2] {
        [
            picture(brightness),
            picture(|x, y| brightness(x + 12.0, y - offset - slope * (x - 160.0))),
        ]
    }

    const SEARCH: Search = Search { first: 0, count: 32 };

    #[test]
    fn rows_that_are_off_and_turned_are_found_to_a_fraction() {
        for (offset, slope) in [(5.3, 0.0), (-3.6, 0.01), (0.4, -0.02)] {
            let [left, right] = moved(offset, slope);
            let found = row_offset(&left, &right, SEARCH).unwrap();
            assert!(
                (found.offset_px - offset).abs() < 0.1,
                "{offset} {slope}: {found:?}"
            );
            assert!(
                (found.slope_x - slope).abs() < 2e-3 && found.slope_y.abs() < 2e-3,
                "{found:?}"
            );
            assert!(found.matches > 60 && found.rms_px < 0.3, "{found:?}");
        }
    }

    #[test]
    fn nothing_is_moved_by_few_matches_by_different_pictures_or_without_need() {
        let [left, right] = moved(0.0, 0.0);
        assert_eq!(row_offset(&left, &right, SEARCH), None);
        let other = picture(|x, y| brightness(x + 1000.0, y + 500.0));
        assert_eq!(row_offset(&left, &other, SEARCH), None);
        let flat = picture(|_, _| 90.0);
        assert_eq!(row_offset(&flat, &flat, SEARCH), None);
        let [mut left, right] = moved(4.0, 0.0);
        left.usable
            .values
            .iter_mut()
            .enumerate()
            .for_each(|(i, usable)| *usable = i % 320 < 40);
        assert_eq!(row_offset(&left, &right, SEARCH), None);
    }
}
