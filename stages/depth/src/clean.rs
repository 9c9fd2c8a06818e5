//! Removal of small islands, and a surface without holes for the next level.

use marf_numeric::visit_parts;

use crate::raster::Raster;
use crate::winner::NONE;

/// Neighbours whose disparities differ by at most this many pixels belong together.
const SAME_SURFACE: f32 = 1.0;

/// Removes connected parts of fewer than `least` pixels.
pub(crate) fn remove_islands(disparity: &mut Raster<f32>, least: usize) {
    let values = &disparity.values;
    let is_known: Vec<bool> = values.iter().map(|value| *value != NONE).collect();
    let is_joined = |a: usize, b: usize| (values[a] - values[b]).abs() <= SAME_SURFACE;
    let mut islands = Vec::new();
    visit_parts(&is_known, disparity.width, is_joined, |part| {
        if part.len() < least {
            islands.extend_from_slice(part);
        }
    });
    for pixel in islands {
        disparity.values[pixel] = NONE;
    }
}

/// Fills holes of each row with the farther of the two nearest known pixels, and empty rows from the row above or,
/// at the top, below. What hides is nearer than what is hidden, so a hole is farther. Without any known pixel, all is `otherwise`.
pub(crate) fn filled(disparity: &Raster<f32>, otherwise: f32) -> Raster<f32> {
    let mut filled = disparity.clone();
    let mut empty = Vec::new();
    for (y, row) in filled.values.chunks_exact_mut(disparity.width).enumerate() {
        if !fill_row(row) {
            empty.push(y);
        }
    }
    let width = disparity.width;
    let known = |y: &usize| empty.binary_search(y).is_err();
    for &y in &empty {
        let source = (0..y)
            .rev()
            .find(known)
            .or_else(|| (y..disparity.height).find(known));
        match source {
            Some(from) => filled
                .values
                .copy_within(from * width..(from + 1) * width, y * width),
            None => filled.values[y * width..(y + 1) * width].fill(otherwise),
        }
    }
    filled
}

/// Fills the holes of a row. Returns whether it has a known pixel.
fn fill_row(row: &mut [f32]) -> bool {
    let mut left = NONE;
    let mut x = 0;
    while x < row.len() {
        if row[x] != NONE {
            left = row[x];
            x += 1;
            continue;
        }
        let end = (x..row.len()).find(|&x| row[x] != NONE).unwrap_or(row.len());
        let right = row.get(end).copied().unwrap_or(NONE);
        let value = if left == NONE {
            right
        } else if right == NONE {
            left
        } else {
            left.min(right)
        };
        row[x..end].fill(value);
        x = end;
    }
    row.first().is_some_and(|&first| first != NONE)
}

/// How far an edge reaches, in pixels.
const EDGE_REACH: isize = 2;

/// A jump between neighbouring surfaces, in pixels of disparity.
const JUMP: f32 = 2.0;

/// Returns whether a pixel with another surface is at most [`EDGE_REACH`] away.
pub(crate) fn beside_a_jump(disparity: &Raster<f32>, x: usize, y: usize) -> bool {
    let here = disparity.at(x, y);
    let reach = -EDGE_REACH..=EDGE_REACH;
    reach.clone().any(|dy| {
        reach.clone().any(|dx| {
            let there = disparity.clamped(x as isize + dx, y as isize + dy);
            there != NONE && (there - here).abs() > JUMP * dx.abs().max(dy.abs()).max(1) as f32
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raster(width: usize, values: &[f32]) -> Raster<f32> {
        Raster {
            width,
            height: values.len() / width,
            values: values.to_vec(),
        }
    }

    #[test]
    fn islands_go_and_slopes_stay() {
        let mut map = raster(4, &[1.0, 2.0, 9.0, 9.5, 1.0, 3.0, NONE, NONE]);
        remove_islands(&mut map, 3);
        assert_eq!(map.values, [1.0, 2.0, NONE, NONE, 1.0, 3.0, NONE, NONE]);
    }

    #[test]
    fn holes_are_filled_with_the_farther_side_and_empty_rows_with_the_next() {
        let map = raster(
            4,
            &[
                NONE, NONE, NONE, NONE, 7.0, NONE, 3.0, NONE, NONE, NONE, NONE, NONE,
            ],
        );
        let row = [7.0, 3.0, 3.0, 3.0];
        assert_eq!(filled(&map, 1.0).values, [row, row, row].concat());
        assert_eq!(filled(&raster(2, &[NONE; 4]), 1.5).values, [1.5; 4]);
    }

    #[test]
    fn an_edge_is_a_jump_of_two_pixels_a_pixel() {
        let map = raster(5, &[5.0, 6.0, 7.0, 12.0, 12.0]);
        let found: Vec<bool> = (0..5).map(|x| beside_a_jump(&map, x, 0)).collect();
        assert_eq!(found, [false, true, true, true, true]);
        assert!(!beside_a_jump(&raster(2, &[5.0, NONE]), 0, 0));
    }
}
