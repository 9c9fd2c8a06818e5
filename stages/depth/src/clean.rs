//! Removal of small islands, and a surface without holes for the next level.

use crate::raster::Raster;
use crate::winner::NONE;

/// Neighbours whose disparities differ by at most this many pixels belong together.
const SAME_SURFACE: f32 = 1.0;

/// Removes connected parts of fewer than `least` pixels.
pub(crate) fn remove_islands(disparity: &mut Raster<f32>, least: usize) {
    let (width, height) = (disparity.width, disparity.height);
    let mut seen = vec![false; disparity.values.len()];
    let mut part = Vec::new();
    for start in 0..disparity.values.len() {
        if seen[start] || disparity.values[start] == NONE {
            continue;
        }
        part.clear();
        part.push(start);
        seen[start] = true;
        let mut next = 0;
        while next < part.len() {
            let at = part[next];
            next += 1;
            let (x, y) = (at % width, at / width);
            let neighbours = [
                (x > 0, at.wrapping_sub(1)),
                (x + 1 < width, at + 1),
                (y > 0, at.wrapping_sub(width)),
                (y + 1 < height, at + width),
            ];
            for (inside, to) in neighbours {
                if inside && !seen[to] && (disparity.values[to] - disparity.values[at]).abs() <= SAME_SURFACE
                {
                    seen[to] = true;
                    part.push(to);
                }
            }
        }
        if part.len() < least {
            for &at in &part {
                disparity.values[at] = NONE;
            }
        }
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
