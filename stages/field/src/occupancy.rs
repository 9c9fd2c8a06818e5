//! Which cells of the contracted box may hold matter.

use rayon::prelude::*;

use crate::View;
use crate::cpu::march::{Bits, expand};
use crate::frame::Frame;
use crate::rng::{Purpose, Rng};

/// A cell counts as occupied if a step of the shortest length in it has at least this optical depth, or the
/// mean of all cells if that is less (instant-ngp).
const OCCUPIED: f32 = 0.01;
/// What is left of a density when its cell is looked at again.
const DECAY: f32 = 0.8;
/// Density of a cell that has not been looked at: it stays occupied until it is. exp(10) is the most otherwise.
const UNKNOWN: f32 = 1e6;
/// Cells of a brick a side: seen or not is first decided brick by brick.
const BRICK: u32 = 4;

/// Densities of cells and the bits made from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Occupancy {
    /// `[side^3]`, x fastest; -1 where no camera looks.
    pub density: Vec<f32>,
    /// Cells that rays visit.
    pub bits: Bits,
}

/// A cell to look at, and a random point in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// The cell.
    pub cell: u32,
    /// The point, in the unit box.
    pub at: [f32; 3],
}

impl Occupancy {
    /// All seen cells occupied.
    pub fn new(side: u32, frame: &Frame, views: &[View]) -> Self {
        let seen = seen_cells(side, frame, views);
        let mut bits = Bits::new(side);
        for (cell, _) in seen.iter().enumerate().filter(|(_, seen)| **seen) {
            bits.set(cell);
        }
        let density = seen.iter().map(|seen| if *seen { UNKNOWN } else { -1.0 });
        Self {
            density: density.collect(),
            bits,
        }
    }

    /// Returns the share of cells that some camera sees.
    pub fn seen_share(&self) -> f64 {
        let seen = self.density.iter().filter(|density| **density >= 0.0).count();
        seen as f64 / self.density.len() as f64
    }

    /// Chooses the cells of update number `round`: of occupied cells one in `occupied`, of empty ones one in `empty`.
    pub fn probes(&self, seed: u64, round: u64, occupied: u64, empty: u64) -> Vec<Probe> {
        let side = self.bits.side;
        let cells = (0..self.density.len() as u32).into_par_iter();
        let chosen = cells.filter_map(|cell| {
            if self.density[cell as usize] < 0.0 {
                return None;
            }
            let every = if self.bits.holds(cell) { occupied } else { empty };
            if !(u64::from(cell) * 7 + round).is_multiple_of(every) {
                return None;
            }
            let mut rng = Rng::new(seed, Purpose::Occupancy, round, u64::from(cell));
            let corner = [cell % side, cell / side % side, cell / side / side];
            let at = corner.map(|corner| (corner as f32 + rng.unit()) / side as f32);
            Some(Probe { cell, at })
        });
        chosen.collect()
    }

    /// Takes over the densities found at the probes and decides all bits anew.
    ///
    /// `step`: the shortest step, contracted. Densities that are not finite are left out.
    pub fn update(&mut self, probes: &[Probe], found: &[f32], step: f32) {
        for (probe, found) in probes.iter().zip(found).filter(|(_, found)| found.is_finite()) {
            let density = &mut self.density[probe.cell as usize];
            let before = if *density < UNKNOWN { *density * DECAY } else { 0.0 };
            *density = before.max(*found);
        }
        let seen = self
            .density
            .iter()
            .filter(|density| (0.0..UNKNOWN).contains(*density));
        let (sum, count) = seen.fold((0.0_f64, 0_u64), |(sum, count), density| {
            (sum + f64::from(*density), count + 1)
        });
        let mean = (sum / count.max(1) as f64) as f32;
        let least = (OCCUPIED / step).min(mean);
        let words = self.density.chunks(64).map(|cells| {
            let bits = cells.iter().enumerate();
            bits.fold(0_u64, |word, (bit, density)| {
                word | u64::from(*density >= least && *density >= 0.0) << bit
            })
        });
        self.bits.words = words.collect();
    }
}

/// Tells for every cell whether some camera looks at it; a margin makes the answer yes where in doubt.
fn seen_cells(side: u32, frame: &Frame, views: &[View]) -> Vec<bool> {
    let bricks = side / BRICK;
    let watchers: Vec<_> = views
        .iter()
        .map(|view| Watcher {
            view,
            bend_px: bend_px(&view.camera),
        })
        .collect();
    let slabs = (0..bricks).into_par_iter().map(|slab| {
        let mut seen = vec![false; (side * side * BRICK) as usize];
        let mut last = 0;
        for y in 0..bricks {
            for x in 0..bricks {
                if !seen_by(&watchers, &mut last, &ball(frame, bricks, [x, y, slab])) {
                    continue;
                }
                for inner in 0..BRICK.pow(3) {
                    let [dx, dy, dz] = [inner % BRICK, inner / BRICK % BRICK, inner / BRICK / BRICK];
                    let cell = [x * BRICK + dx, y * BRICK + dy, slab * BRICK + dz];
                    let index = (dz * side + cell[1]) * side + cell[0];
                    seen[index as usize] = seen_by(&watchers, &mut last, &ball(frame, side, cell));
                }
            }
        }
        seen
    });
    slabs.collect::<Vec<_>>().concat()
}

/// A view and how far its distortion moves a corner.
struct Watcher<'a> {
    view: &'a View,
    bend_px: f64,
}

/// Centre and radius of a cell in the world.
struct Ball {
    centre: nalgebra::Vector3<f64>,
    radius: f64,
}

fn ball(frame: &Frame, side: u32, cell: [u32; 3]) -> Ball {
    let corner = |add: f64| frame.outward(expand(cell.map(|cell| (f64::from(cell) + add) / f64::from(side))));
    let centre = corner(0.5);
    let radius = (corner(0.0) - centre).norm().max((corner(1.0) - centre).norm());
    Ball { centre, radius }
}

/// Asks the camera that answered last first: neighbours are mostly seen by the same one.
fn seen_by(views: &[Watcher], last: &mut usize, ball: &Ball) -> bool {
    let order = std::iter::once(*last).chain(0..views.len());
    for view in order.filter(|view| *view < views.len()) {
        if sees(&views[view], ball) {
            *last = view;
            return true;
        }
    }
    false
}

fn sees(watcher: &Watcher, ball: &Ball) -> bool {
    let camera = &watcher.view.camera;
    let at = watcher.view.cam_from_world.point(&ball.centre);
    if at.norm() <= ball.radius {
        return true;
    }
    if at.z <= -ball.radius {
        return false;
    }
    // Where the centre has no pixel, the nearest point in front that has one decides by the margin.
    let depth = at.z.max(0.25 * ball.radius);
    let pixel = [
        camera.fx_px.mul_add(at.x / depth, camera.cx_px),
        camera.fy_px.mul_add(at.y / depth, camera.cy_px),
    ];
    let margin = camera.fx_px.max(camera.fy_px) * ball.radius / depth + watcher.bend_px;
    pixel[0] > -margin
        && pixel[1] > -margin
        && pixel[0] < f64::from(camera.width) + margin
        && pixel[1] < f64::from(camera.height) + margin
}

/// How far the distortion moves the corners of the photo outwards at most, pixels.
fn bend_px(camera: &marf_scene::Camera) -> f64 {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
    let moved = corners.map(|[x, y]| {
        let Some(ray) = camera.unproject(&nalgebra::Vector2::new(x, y)) else {
            return width.max(height);
        };
        let plain = [
            camera.fx_px.mul_add(ray.x, camera.cx_px),
            camera.fy_px.mul_add(ray.y, camera.cy_px),
        ];
        (plain[0] - x).abs().max((plain[1] - y).abs())
    });
    moved.into_iter().fold(0.0, f64::max)
}
