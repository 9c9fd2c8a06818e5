//! The ground: a height field, finely gridded around the outcrop and smooth beyond.

use rayon::prelude::*;

use super::{
    math::{V3, noise2, sin_cos, smoothstep, v3},
    rocks::{Ray, Rock},
};

/// Middle of the gridded square, metres in the site: the outcrop.
pub const OUTCROP: (f64, f64) = (7.0, 3.0);
/// Nodes a side of the grid.
const SIDE: usize = 1024;
/// Metres between nodes.
const STEP: f64 = 0.04;
const HALF_EXTENT: f64 = (SIDE - 1) as f64 * STEP / 2.0;
/// Steepest rise the march reckons with; the steepest ripple has 0.35, skirts of rocks 0.4.
const STEEPEST: f64 = 0.55;
/// Nothing of the ground is higher, metres.
const CEILING: f64 = 1.6;
/// Where the plain ends in haze, metres.
pub const FAR: f64 = 600.0;

/// A node: height in metres, slope along x and y, and the share of the sky it sees.
type Cell = [f32; 4];

pub struct Ground {
    cells: Vec<Cell>,
}

impl Ground {
    pub fn new(salt: u32, rocks: &[Rock]) -> Self {
        let mut heights = vec![(0.0_f64, 1.0_f64); SIDE * SIDE];
        heights.par_chunks_mut(SIDE).enumerate().for_each(|(row, chunk)| {
            for (column, cell) in chunk.iter_mut().enumerate() {
                let (x, y) = position(column, row);
                cell.0 = height_without_rocks(x, y, salt);
            }
        });
        for rock in rocks {
            settle(&mut heights, rock);
        }
        Self {
            cells: with_slopes(&heights),
        }
    }

    pub fn height(&self, salt: u32, x: f64, y: f64) -> f64 {
        self.lookup(x, y).map_or_else(|| plain(x, y, salt), |cell| cell[0])
    }

    /// Returns where a ray meets the ground.
    pub fn first(&self, salt: u32, ray: &Ray) -> Option<f64> {
        let (from, along) = (ray.from, ray.along);
        let level = (along.x * along.x + along.y * along.y).sqrt();
        let pace = 1.0 / (along.z.abs() + STEEPEST * level);
        let mut t = ((from.z - CEILING) / -along.z).max(0.0);
        if along.z >= 0.0 {
            if from.z > CEILING {
                return None;
            }
            t = 0.0;
        }
        for _ in 0..160 {
            let p = ray.at(t);
            let room = p.z - self.height(salt, p.x, p.y);
            if room < 0.000_2 * t.max(1.0) {
                return Some(t + room * pace);
            }
            t += room * pace;
            if t > FAR || (along.z > 0.0 && p.z > CEILING) {
                return None;
            }
        }
        Some(t)
    }

    /// Returns slope along x, along y, and the share of the sky seen.
    pub fn lie(&self, salt: u32, x: f64, y: f64) -> (f64, f64, f64) {
        if let Some([_, dx, dy, open]) = self.lookup(x, y) {
            return (dx, dy, open);
        }
        let step = 0.3;
        let slope = |dx: f64, dy: f64| {
            (plain(x + dx, y + dy, salt) - plain(x - dx, y - dy, salt)) / (2.0 * step)
        };
        (slope(step, 0.0), slope(0.0, step), 1.0)
    }

    fn lookup(&self, x: f64, y: f64) -> Option<[f64; 4]> {
        let (u, v) = (
            (x - OUTCROP.0 + HALF_EXTENT) / STEP,
            (y - OUTCROP.1 + HALF_EXTENT) / STEP,
        );
        let limit = (SIDE - 1) as f64;
        if !(u >= 0.0 && v >= 0.0 && u < limit && v < limit) {
            return None;
        }
        let (i, j) = (u as usize, v as usize);
        let (u, v) = (u - i as f64, v - j as f64);
        let at = j * SIDE + i;
        let (a, b) = (&self.cells[at], &self.cells[at + 1]);
        let (c, d) = (&self.cells[at + SIDE], &self.cells[at + SIDE + 1]);
        Some(std::array::from_fn(|k| {
            let top = f64::from(a[k]) + (f64::from(b[k]) - f64::from(a[k])) * u;
            let bottom = f64::from(c[k]) + (f64::from(d[k]) - f64::from(c[k])) * u;
            top + (bottom - top) * v
        }))
    }
}

fn position(column: usize, row: usize) -> (f64, f64) {
    (
        OUTCROP.0 - HALF_EXTENT + column as f64 * STEP,
        OUTCROP.1 - HALF_EXTENT + row as f64 * STEP,
    )
}

/// The large forms: swells of the plain and the rise on which the outcrop stands.
pub fn plain(x: f64, y: f64, salt: u32) -> f64 {
    let swell = |size: f64, salt: u32| noise2(x / size + 0.37, y / size + 0.11, salt).0;
    let (dx, dy) = (x - OUTCROP.0, y - OUTCROP.1);
    let from_outcrop = (dx * dx + dy * dy).sqrt();
    let rise = 0.34 * smoothstep(3.6, 0.4, from_outcrop + 0.5 * swell(1.7, salt ^ 9));
    let far = smoothstep(20.0, 90.0, from_outcrop);
    0.10 * swell(7.0, salt ^ 1) + rise + far * 0.7 * swell(46.0, salt ^ 3) + 0.14 * swell(19.0, salt ^ 2)
}

/// Share of drifted sand, 0 to 1: there are ripples and few stones.
pub fn sandiness(x: f64, y: f64, salt: u32) -> f64 {
    let patches = noise2(x / 3.1, y / 3.1, salt ^ 21).0 + 0.4 * noise2(x / 1.1, y / 1.1, salt ^ 22).0;
    smoothstep(-0.25, 0.45, patches)
}

/// Height of a ripple's profile at a phase in turns: a gentle stoss side, a steeper lee.
fn ripple(phase: f64) -> f64 {
    let (sin, _) = sin_cos(2.0 * std::f64::consts::PI * phase);
    let (skew, _) = sin_cos(2.0 * std::f64::consts::PI * phase + 0.55 * sin);
    skew
}

fn height_without_rocks(x: f64, y: f64, salt: u32) -> f64 {
    let (dx, dy) = (x - OUTCROP.0, y - OUTCROP.1);
    let inside = smoothstep(HALF_EXTENT - 0.5, HALF_EXTENT - 6.0, (dx * dx + dy * dy).sqrt());
    if inside == 0.0 {
        return plain(x, y, salt);
    }
    let lumps = |size: f64, salt: u32| noise2((x + 0.3 * y) / size, (y - 0.3 * x) / size, salt).0;
    let bend = 0.7 * lumps(1.9, salt ^ 31) + 0.22 * lumps(0.6, salt ^ 32);
    let ripples = 0.0085 * ripple((x * 0.82 + y * 0.57) / 0.27 + bend);
    let sand = sandiness(x, y, salt);
    let rough = 0.018 * lumps(0.55, salt ^ 33) + 0.008 * lumps(0.23, salt ^ 34);
    plain(x, y, salt) + inside * (ripples * sand + rough * (1.0 - 0.6 * sand) + 0.004 * lumps(0.12, salt ^ 35))
}

/// Lets sand creep up around a rock, and takes the sky away from the ground close to it.
fn settle(cells: &mut [(f64, f64)], rock: &Rock) {
    let wide = (rock.half.x + rock.half.y) / 2.0;
    if wide < 0.03 {
        return;
    }
    let reach = wide * 2.2 + 0.04;
    let top = rock.half.z.min(wide);
    let index = |value: f64, middle: f64| ((value - middle + HALF_EXTENT) / STEP).clamp(0.0, (SIDE - 1) as f64) as usize;
    for row in index(rock.centre.y - reach, OUTCROP.1)..=index(rock.centre.y + reach, OUTCROP.1) {
        for column in index(rock.centre.x - reach, OUTCROP.0)..=index(rock.centre.x + reach, OUTCROP.0) {
            let (x, y) = position(column, row);
            let off = rock.local(v3(x, y, rock.centre.z) - rock.centre);
            let (u, v) = (off.x / rock.half.x, off.y / rock.half.y);
            let near = smoothstep(2.2, 0.8, (u * u + v * v).sqrt());
            let cell = &mut cells[row * SIDE + column];
            cell.0 += 0.16 * top * near * near;
            cell.1 *= 1.0 - 0.42 * near;
        }
    }
}

fn with_slopes(heights: &[(f64, f64)]) -> Vec<Cell> {
    let last = SIDE - 1;
    let at = |column: usize, row: usize| heights[row * SIDE + column].0;
    (0..SIDE * SIDE)
        .into_par_iter()
        .map(|index| {
            let (column, row) = (index % SIDE, index / SIDE);
            let (left, right) = (column.saturating_sub(1), (column + 1).min(last));
            let (above, below) = (row.saturating_sub(1), (row + 1).min(last));
            let dx = (at(right, row) - at(left, row)) / ((right - left) as f64 * STEP);
            let dy = (at(column, below) - at(column, above)) / ((below - above) as f64 * STEP);
            let (height, open) = heights[index];
            [height as f32, dx as f32, dy as f32, open as f32]
        })
        .collect()
}

/// Upward unit normal of a surface with these slopes.
pub fn normal_of(slope_x: f64, slope_y: f64) -> V3 {
    v3(-slope_x, -slope_y, 1.0).unit()
}
