//! The ground: a height field on three nested grids, the finest around the outcrop.

use rayon::prelude::*;

use super::{
    math::{V3, Vector, noise2, sin_cos, smoothstep, v3},
    rocks::{Ray, Rock},
};

/// Centre of the outcrop and of all grids, metres in the site.
pub const OUTCROP: [f64; 2] = [7.0, 3.0];
/// Half the side of the finest grid, metres.
const FINE_M: f64 = 20.48;
/// The grids: nodes per side, metres between them. The first has ripples and lumps, the others the large forms only.
const LEVELS: [Lattice; 3] = [lattice(1025, 0.04), lattice(513, 0.4), lattice(513, 2.5)];
/// Slope that ray marching assumes. Ripples are steeper, but a step is at most about ten times the height
/// above ground, too short to pass through one. If it ends below ground, the change of sign is detected.
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
    /// Relative brightness of the colour. 0 is the mean.
    pub tone: f64,
}

/// A point of a ray and its height above the ground, metres.
#[derive(Clone, Copy)]
struct Clearance {
    range_m: f64,
    height_m: f64,
}

/// A square lattice around the outcrop.
#[derive(Clone, Copy)]
struct Lattice {
    /// Nodes per side.
    side: usize,
    /// Distance of neighbours, metres.
    step_m: f64,
}

/// A node of a lattice while the ground is made.
struct GroundNode {
    height_m: f64,
    /// Visible share of the sky.
    open: f64,
}

/// A square grid of nodes.
struct Grid {
    lattice: Lattice,
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
        let grid = |lattice: &Lattice| Grid::new(*lattice, salt, rocks);
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
        let mut above = Clearance {
            range_m: t,
            height_m: f64::INFINITY,
        };
        for _ in 0..200 {
            let here = self.clearance(ray, t);
            if here.height_m < 0.0 && above.height_m.is_finite() {
                return Some(self.crossing(ray, above, here));
            }
            if here.height_m < 0.000_2 * t {
                return Some(t + here.height_m * pace);
            }
            above = here;
            t += here.height_m * pace;
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

    fn clearance(&self, ray: &Ray, range_m: f64) -> Clearance {
        let p = ray.at(range_m);
        Clearance {
            range_m,
            height_m: p.z - self.height(p.x, p.y),
        }
    }

    /// Finds the crossing between two points above and below ground by four steps of the secant method.
    fn crossing(&self, ray: &Ray, mut above: Clearance, mut below: Clearance) -> f64 {
        let chord = |a: Clearance, b: Clearance| {
            a.range_m + (b.range_m - a.range_m) * (a.height_m / (a.height_m - b.height_m))
        };
        for _ in 0..4 {
            let t = chord(above, below);
            let here = self.clearance(ray, t);
            if here.height_m.abs() < 0.000_05 * t {
                return t;
            }
            if here.height_m > 0.0 {
                above = here;
            } else {
                below = here;
            }
        }
        chord(above, below)
    }

    /// Reads from the finest grid that holds a point. Beyond the last grid, its border is repeated.
    fn at<T>(&self, x: f64, y: f64, read: impl Fn(&Grid, &Spot) -> T) -> T {
        let (x, y) = (x - OUTCROP[0], y - OUTCROP[1]);
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

const fn lattice(side: usize, step_m: f64) -> Lattice {
    Lattice { side, step_m }
}

impl Lattice {
    /// Returns the place of a node in the site, metres.
    fn place(&self, index: usize) -> (f64, f64) {
        let middle = (self.side / 2) as f64;
        (
            OUTCROP[0] + ((index % self.side) as f64 - middle) * self.step_m,
            OUTCROP[1] + ((index / self.side) as f64 - middle) * self.step_m,
        )
    }

    /// Returns slope along x and y, openness, sand, dust and tone at a node.
    fn point(&self, nodes: &[GroundNode], index: usize, salt: u32) -> [f32; 6] {
        let (side, step_m) = (self.side, self.step_m);
        let (column, row) = (index % side, index / side);
        let (left, right) = (column.saturating_sub(1), (column + 1).min(side - 1));
        let (above, below) = (row.saturating_sub(1), (row + 1).min(side - 1));
        let at = |column: usize, row: usize| nodes[row * side + column].height_m;
        let slope_x = (at(right, row) - at(left, row)) / ((right - left) as f64 * step_m);
        let slope_y = (at(column, below) - at(column, above)) / ((below - above) as f64 * step_m);
        let (x, y) = self.place(index);
        let sand = sandiness(x, y, salt);
        let (dusty, tone) = broad_tint(x, y, sand, salt);
        [slope_x, slope_y, nodes[index].open, sand, dusty, tone].map(|number| number as f32)
    }

    /// Piles sand against a rock, and lowers the visible share of the sky next to it.
    fn settle(&self, nodes: &mut [GroundNode], rock: &Rock) {
        let (side, step_m) = (self.side, self.step_m);
        let wide = (rock.half.x + rock.half.y) / 2.0;
        if wide < 0.03 {
            return;
        }
        let reach = wide * 2.2 + 0.04;
        let top = rock.half.z.min(wide);
        let middle = (side / 2) as f64;
        let index = |offset: f64| (offset / step_m + middle).clamp(0.0, (side - 1) as f64) as usize;
        let (x, y) = (rock.centre.x - OUTCROP[0], rock.centre.y - OUTCROP[1]);
        for row in index(y - reach)..=index(y + reach) {
            for column in index(x - reach)..=index(x + reach) {
                let dx = (column as f64 - middle) * step_m - x;
                let dy = (row as f64 - middle) * step_m - y;
                let off = rock.local(v3(dx, dy, 0.0));
                let (u, v) = (off.x / rock.half.x, off.y / rock.half.y);
                let near = smoothstep(2.2, 0.8, (u * u + v * v).sqrt());
                let node = &mut nodes[row * side + column];
                node.height_m += 0.16 * top * near * near;
                node.open *= 1.0 - 0.42 * near;
            }
        }
    }
}

impl Grid {
    fn new(lattice: Lattice, salt: u32, rocks: &[Rock]) -> Self {
        let is_fine = lattice.step_m == LEVELS[0].step_m;
        let form = if is_fine { height_without_rocks } else { plain };
        let count = lattice.side * lattice.side;
        let node = |index: usize| {
            let (x, y) = lattice.place(index);
            GroundNode {
                height_m: form(x, y, salt),
                open: 1.0,
            }
        };
        let mut nodes: Vec<GroundNode> = (0..count).into_par_iter().map(node).collect();
        if is_fine {
            rocks.iter().for_each(|rock| lattice.settle(&mut nodes, rock));
        }
        let point = |index: usize| lattice.point(&nodes, index, salt);
        Self {
            lattice,
            points: (0..count).into_par_iter().map(point).collect(),
            heights: nodes.iter().map(|node| node.height_m as f32).collect(),
        }
    }

    fn half_m(&self) -> f64 {
        (self.lattice.side / 2) as f64 * self.lattice.step_m
    }

    /// Returns the cell of a point, `x` and `y` from the centre in metres, clamped into the grid.
    fn spot(&self, x: f64, y: f64) -> Spot {
        let Lattice { side, step_m } = self.lattice;
        let last = (side - 1) as f64 - 1e-6;
        let u = ((x + self.half_m()) / step_m).clamp(0.0, last);
        let v = ((y + self.half_m()) / step_m).clamp(0.0, last);
        let (i, j) = (u as usize, v as usize);
        Spot {
            index: j * side + i,
            side,
            u: u - i as f64,
            v: v - j as f64,
        }
    }
}

/// Returns the height of the large forms: swells of the plain, and the rise below the outcrop.
pub fn plain(x: f64, y: f64, salt: u32) -> f64 {
    let swell = |size: f64, salt: u32| noise2(x / size + 0.37, y / size + 0.11, salt).0;
    let (dx, dy) = (x - OUTCROP[0], y - OUTCROP[1]);
    let from_outcrop = (dx * dx + dy * dy).sqrt();
    let rise = 0.34 * smoothstep(3.6, 0.4, from_outcrop + 0.5 * swell(1.7, salt ^ 9));
    let far = smoothstep(20.0, 90.0, from_outcrop);
    0.10 * swell(7.0, salt ^ 1) + rise + far * 0.7 * swell(46.0, salt ^ 3) + 0.14 * swell(19.0, salt ^ 2)
}

/// Returns the share of drifted sand, 0 to 1. Sand has ripples and few stones.
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
    let (dx, dy) = (x - OUTCROP[0], y - OUTCROP[1]);
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
