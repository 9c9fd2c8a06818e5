//! Which cells of the contracted box some camera looks at.

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use crate::View;
use crate::cpu::space::expand;
use crate::frame::Frame;

/// Cells of a brick a side: seen or not is first decided brick by brick.
const BRICK: u32 = 4;

/// Returns for every cell whether some camera looks at it. A margin makes the answer yes where in doubt.
pub fn seen_cells(side: u32, frame: &Frame, views: &[View]) -> Vec<bool> {
    let bricks = side / BRICK;
    let watchers: Vec<_> = views
        .iter()
        .map(|view| Watcher {
            view,
            distortion_px: distortion_px(&view.camera),
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
    distortion_px: f64,
}

/// Centre and radius of a cell in the world.
struct Ball {
    centre: Vector3<f64>,
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
    let margin = camera.fx_px.max(camera.fy_px) * ball.radius / depth + watcher.distortion_px;
    pixel[0] > -margin
        && pixel[1] > -margin
        && pixel[0] < f64::from(camera.width) + margin
        && pixel[1] < f64::from(camera.height) + margin
}

/// Returns how far the distortion moves the corners of the photo outwards at most, pixels.
fn distortion_px(camera: &marf_scene::Camera) -> f64 {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let corners = [[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]];
    let moved = corners.map(|[x, y]| {
        let Some(ray) = camera.unproject(&Vector2::new(x, y)) else {
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
