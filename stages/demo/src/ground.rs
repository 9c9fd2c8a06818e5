//! The ground: a height field on three nested grids, the finest around the outcrop.

use rayon::prelude::*;

use super::{
    math::{V3, noise2, sin_cos, smoothstep, v3},
    rocks::{Ray, Rock},
};

/// Centre of the outcrop and of all grids, metres in the site.
pub const OUTCROP: (f64, f64) = (7.0, 3.0);
/// Half the side of the finest grid, metres.
const FINE_M: f64 = 20.48;
/// The grids: nodes per side, metres between them. The first has ripples and lumps, the others the large forms only.
const LEVELS: [(usize, f64); 3] = [(1025, 0.04), (513, 0.4), (513, 2.5)];
/// Slope that ray marching assumes. Ripples are steeper, but a step is at most about ten times the height above
/// ground, too short to pass through one; where it ends below ground, the change of sign is detected.
const STEEPEST: f64 = 0.10;
/// Upper bound of the ground's height, metres.
const CEILING: f64 = 1.6;
/// Distance at which the plain ends in haze, metres.
pub const FAR: f64 = 600.0;

/// Slope and composition of the ground at a point.
#[derive(Debug, Clone, Copy)]
pub struct GroundPoint {
    /// Rise along x and y.
    pub slope: (f64, f64),
    /// Visible share of the sky.
    pub open: f64,
    /// Share of drifted sand.
    pub sand: f64,
    /// Share of dust in the colour.
    pub dusty: f64,
    /// Relative brightness of the colour; 0 is the mean.
    pub tone: f64,
}

/// A square grid of nodes.
struct Grid {
    side: usize,
    step_m: f64,
    /// Heights, metres.
    heights: Vec<f32>,
    /// Slope along x and y, openness, sand, dust, tone.
    points: Vec<[f32; 6]>,
}

pub struct Ground {
    grids: Vec<Grid>,
}

impl Ground {
    pub fn new(salt: u32, rocks: &[Rock]) -> Self {
        let grid = |&(side, step_m): &(usize, f64)| Grid::new(side, step_m, salt, rocks);
        Self {
            grids: LEVELS.iter().map(grid).collect(),
        }
    }

    pub fn height(&self, x: f64, y: f64) -> f64 {
        self.at(x, y, |grid, spot| {
            spot.blend(|index| f64::from(grid.heights[index]))
        })
    }

    /// Returns the distance at which a ray meets the ground.
    pub fn first(&self, ray: &Ray) -> Option<f64> {
        let (from, along) = (ray.from, ray.along);
        let level = (along.x * along.x + along.y * along.y).sqrt();
        let pace = 1.0 / (along.z.abs() + STEEPEST * level);
        if along.z >= 0.0 && from.z > CEILING {
            return None;
        }
        let mut t = if along.z < 0.0 {
            ((from.z - CEILING) / -along.z).max(0.0)
        } else {
            0.0
        };
        let mut above = (t, f64::INFINITY);
        for _ in 0..200 {
            let clearance = self.clearance(ray, t);
            if clearance < 0.0 && above.1.is_finite() {
                return Some(self.crossing(ray, above, (t, clearance)));
            }
            if clearance < 0.000_2 * t {
                return Some(t + clearance * pace);
            }
            above = (t, clearance);
            t += clearance * pace;
            if t > FAR || (along.z > 0.0 && from.z + along.z * t > CEILING) {
                return None;
            }
        }
        Some(t)
    }

    /// Returns slope and composition of the ground at a point.
    pub fn point(&self, x: f64, y: f64) -> GroundPoint {
        self.at(x, y, |grid, spot| {
            let part = |k: usize| spot.blend(|index| f64::from(grid.points[index][k]));
            GroundPoint {
                slope: (part(0), part(1)),
                open: part(2),
                sand: part(3),
                dusty: part(4),
                tone: part(5),
            }
        })
    }

    fn clearance(&self, ray: &Ray, t: f64) -> f64 {
        let p = ray.at(t);
        p.z - self.height(p.x, p.y)
    }

    /// Finds the crossing between two points above and below ground by four steps of the secant method.
    fn crossing(&self, ray: &Ray, mut above: (f64, f64), mut below: (f64, f64)) -> f64 {
        let chord = |a: (f64, f64), b: (f64, f64)| a.0 + (b.0 - a.0) * (a.1 / (a.1 - b.1));
        for _ in 0..4 {
            let t = chord(above, below);
            let clearance = self.clearance(ray, t);
            if clearance.abs() < 0.000_05 * t {
                return t;
            }
            if clearance > 0.0 {
                above = (t, clearance);
            } else {
                below = (t, clearance);
            }
        }
        chord(above, below)
    }

    /// Reads from the finest grid that holds a point; beyond the last grid, its border is repeated.
    fn at<T>(&self, x: f64, y: f64, read: impl Fn(&Grid, &Spot) -> T) -> T {
        let (x, y) = (x - OUTCROP.0, y - OUTCROP.1);
        let far = x.abs().max(y.abs());
        let holds = |grid: &&Grid| far < grid.half_m();
        let last = &self.grids[self.grids.len() - 1];
        let grid = self.grids.iter().find(holds).unwrap_or(last);
        read(grid, &grid.spot(x, y))
    }
}

/// A position within a grid cell.
struct Spot {
    index: usize,
    side: usize,
    u: f64,
    v: f64,
}

impl Spot {
    fn blend(&self, node: impl Fn(usize) -> f64) -> f64 {
        let (a, b) = (node(self.index), node(self.index + 1));
        let (c, d) = (node(self.index + self.side), node(self.index + self.side + 1));
        let (top, bottom) = (a + (b - a) * self.u, c + (d - c) * self.u);
        top + (bottom - top) * self.v
    }
}

impl Grid {
    fn new(side: usize, step_m: f64, salt: u32, rocks: &[Rock]) -> Self {
        let fine = step_m == LEVELS[0].1;
        let form = if fine { height_without_rocks } else { plain };
        let place = |index: usize| {
            let middle = (side / 2) as f64;
            (
                OUTCROP.0 + ((index % side) as f64 - middle) * step_m,
                OUTCROP.1 + ((index / side) as f64 - middle) * step_m,
            )
        };
        let mut nodes: Vec<(f64, f64)> = (0..side * side)
            .into_par_iter()
            .map(|index| (form(place(index).0, place(index).1, salt), 1.0))
            .collect();
        if fine {
            rocks
                .iter()
                .for_each(|rock| settle(&mut nodes, side, step_m, rock));
        }
        let points = (0..side * side)
            .into_par_iter()
            .map(|index| point_at(&nodes, side, step_m, index, place(index), salt))
            .collect();
        Self {
            side,
            step_m,
            heights: nodes.iter().map(|node| node.0 as f32).collect(),
            points,
        }
    }

    fn half_m(&self) -> f64 {
        (self.side / 2) as f64 * self.step_m
    }

    /// Returns the cell of a point, `x` and `y` from the centre in metres, clamped into the grid.
    fn spot(&self, x: f64, y: f64) -> Spot {
        let last = (self.side - 1) as f64 - 1e-6;
        let (u, v) = (
            ((x + self.half_m()) / self.step_m).clamp(0.0, last),
            ((y + self.half_m()) / self.step_m).clamp(0.0, last),
        );
        let (i, j) = (u as usize, v as usize);
        Spot {
            index: j * self.side + i,
            side: self.side,
            u: u - i as f64,
            v: v - j as f64,
        }
    }
}

fn point_at(
    nodes: &[(f64, f64)],
    side: usize,
    step_m: f64,
    index: usize,
    place: (f64, f64),
    salt: u32,
) -> [f32; 6] {
    let (column, row) = (index % side, index / side);
    let (left, right) = (column.saturating_sub(1), (column + 1).min(side - 1));
    let (above, below) = (row.saturating_sub(1), (row + 1).min(side - 1));
    let at = |column: usize, row: usize| nodes[row * side + column].0;
    let slope_x = (at(right, row) - at(left, row)) / ((right - left) as f64 * step_m);
    let slope_y = (at(column, below) - at(column, above)) / ((below - above) as f64 * step_m);
    let sand = sandiness(place.0, place.1, salt);
    let (dusty, tone) = broad_tint(place.0, place.1, sand, salt);
    [slope_x, slope_y, nodes[index].1, sand, dusty, tone].map(|number| number as f32)
}

/// Returns the height of the large forms: swells of the plain, and the rise below the outcrop.
pub fn plain(x: f64, y: f64, salt: u32) -> f64 {
    let swell = |size: f64, salt: u32| noise2(x / size + 0.37, y / size + 0.11, salt).0;
    let (dx, dy) = (x - OUTCROP.0, y - OUTCROP.1);
    let from_outcrop = (dx * dx + dy * dy).sqrt();
    let rise = 0.34 * smoothstep(3.6, 0.4, from_outcrop + 0.5 * swell(1.7, salt ^ 9));
    let far = smoothstep(20.0, 90.0, from_outcrop);
    0.10 * swell(7.0, salt ^ 1) + rise + far * 0.7 * swell(46.0, salt ^ 3) + 0.14 * swell(19.0, salt ^ 2)
}

/// Returns the share of drifted sand, 0 to 1; sand has ripples and few stones.
pub fn sandiness(x: f64, y: f64, salt: u32) -> f64 {
    let patches = noise2(x / 3.1, y / 3.1, salt ^ 21).0 + 0.4 * noise2(x / 1.1, y / 1.1, salt ^ 22).0;
    smoothstep(-0.25, 0.45, patches)
}

/// Returns the height of a ripple's profile at a phase in turns: a gentle stoss side, a steeper lee side.
fn ripple(phase: f64) -> f64 {
    let (sin, _) = sin_cos(2.0 * std::f64::consts::PI * phase);
    let (skew, _) = sin_cos(2.0 * std::f64::consts::PI * phase + 0.55 * sin);
    skew
}

fn height_without_rocks(x: f64, y: f64, salt: u32) -> f64 {
    let (dx, dy) = (x - OUTCROP.0, y - OUTCROP.1);
    let inside = smoothstep(FINE_M - 0.5, FINE_M - 6.0, (dx * dx + dy * dy).sqrt());
    if inside == 0.0 {
        return plain(x, y, salt);
    }
    let lumps = |size: f64, salt: u32| noise2((x + 0.3 * y) / size, (y - 0.3 * x) / size, salt).0;
    let phase_shift = 0.7 * lumps(1.9, salt ^ 31) + 0.22 * lumps(0.6, salt ^ 32);
    // Their crests are perpendicular to the sunlight, which makes them visible.
    let ripples = 0.0075 * ripple((0.57 * y - 0.82 * x) / 0.27 + phase_shift);
    let sand = sandiness(x, y, salt);
    let rough = 0.018 * lumps(0.55, salt ^ 33) + 0.008 * lumps(0.23, salt ^ 34);
    plain(x, y, salt)
        + inside * (ripples * sand + rough * (1.0 - 0.6 * sand) + 0.004 * lumps(0.12, salt ^ 35))
}

/// Piles sand against a rock, and lowers the visible share of the sky next to it.
fn settle(nodes: &mut [(f64, f64)], side: usize, step_m: f64, rock: &Rock) {
    let wide = (rock.half.x + rock.half.y) / 2.0;
    if wide < 0.03 {
        return;
    }
    let reach = wide * 2.2 + 0.04;
    let top = rock.half.z.min(wide);
    let middle = (side / 2) as f64;
    let index = |offset: f64| (offset / step_m + middle).clamp(0.0, (side - 1) as f64) as usize;
    let (x, y) = (rock.centre.x - OUTCROP.0, rock.centre.y - OUTCROP.1);
    for row in index(y - reach)..=index(y + reach) {
        for column in index(x - reach)..=index(x + reach) {
            let (dx, dy) = (
                (column as f64 - middle) * step_m - x,
                (row as f64 - middle) * step_m - y,
            );
            let off = rock.local(v3(dx, dy, 0.0));
            let (u, v) = (off.x / rock.half.x, off.y / rock.half.y);
            let near = smoothstep(2.2, 0.8, (u * u + v * v).sqrt());
            let node = &mut nodes[row * side + column];
            node.0 += 0.16 * top * near * near;
            node.1 *= 1.0 - 0.42 * near;
        }
    }
}

/// Returns the upward unit normal of a surface with these slopes.
pub fn normal_of(slope_x: f64, slope_y: f64) -> V3 {
    v3(-slope_x, -slope_y, 1.0).unit()
}

/// Returns the ground's large-scale tint: the share of dust, and a relative brightness.
fn broad_tint(x: f64, y: f64, sand: f64, salt: u32) -> (f64, f64) {
    let broad = noise2(x / 2.3, y / 2.3, salt ^ 41).0;
    let blotch = noise2(x / 0.61, y / 0.61, salt ^ 42).0;
    let dusty = smoothstep(-0.6, 0.9, 0.8 * broad + 0.5 * blotch - 0.9 * (sand - 0.5));
    (dusty, 0.10 * broad + 0.05 * blotch)
}
