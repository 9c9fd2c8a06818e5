//! `true-surface`: a mesh or a cloud of a run next to the true terrain.
//!
//! The terrain is made of the points of the true photos, each with its normal. Points that three training photos show count. Distances
//! of vertices are measured along the normal of the nearest true point. They are printed for the vertices as the file has them, and
//! after the similarity that carries the cameras of the scene to the true ones. The remainder is the surface's own error, not that of
//! the labels.

use std::collections::HashMap;
use std::{fs, path::Path};

use nalgebra::Vector3;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::truth::{Known, KnownScene, Similarity};
use crate::output::{Result, print_json};

/// Side of the cells in which true points are looked up, and farthest that a vertex is looked for, metres.
const CELL_M: f64 = 0.1;
/// Distance between true points that are asked for a vertex, metres.
const APART_M: f64 = 0.05;
/// A photo shows a true point that is at this share of the distance it shows, or nearer.
const SAME: f64 = 0.02;
/// Photos that must show a point.
const PHOTOS: u32 = 3;
/// Bars: distance of vertices to the terrain, and of the terrain to vertices, metres.
const NEAR_M: f64 = 0.02;
const COVERED_M: f64 = 0.05;
/// Distances from the nearest photo that shows a point, metres.
const RANGES_M: [f64; 5] = [3.0, 5.0, 10.0, 20.0, f64::INFINITY];

/// A point of the true terrain.
#[derive(Clone, Copy)]
struct TruePoint {
    position: Vector3<f64>,
    normal: Vector3<f64>,
    photos: u32,
    /// To the nearest photo that shows it.
    range_m: f64,
}

type Grid<T> = HashMap<[i32; 3], Vec<T>>;

/// Prints the figures of a PLY for each range of distances.
pub fn surface(scene: &Path, ply: &Path) -> Result {
    let known = KnownScene::read(scene)?;
    let vertices = vertices(&fs::read(ply)?)?;
    let frames = known.scene.frames.iter().zip(&known.photos);
    let trained: Vec<&Known> = frames
        .filter(|(frame, _)| !frame.held_out)
        .map(|(_, photo)| photo)
        .collect();
    let points: Vec<TruePoint> = trained
        .par_iter()
        .flat_map_iter(|photo| true_points(photo))
        .map(|point| seen(point, &trained))
        .collect();
    for (name, site_from_world) in [
        ("as written", Similarity::identity()),
        ("cameras aligned", known.alignment()),
    ] {
        let vertices = vertices.iter().map(|at| site_from_world.point(at));
        for mut row in rows(&vertices.collect::<Vec<_>>(), &points) {
            row["frame"] = name.into();
            print_json(&row)?;
        }
    }
    Ok(())
}

/// Returns the point of every other pixel with its normal, from its neighbours.
fn true_points(known: &Known) -> Vec<TruePoint> {
    let at = |column: u32, row: u32| known.point(column, row, f64::INFINITY);
    let point = |column: u32, row: u32| {
        let position = at(column, row)?;
        let across = at(column + 1, row)? - at(column - 1, row)?;
        let down = at(column, row + 1)? - at(column, row - 1)?;
        Some(TruePoint {
            position,
            normal: down.cross(&across).try_normalize(0.0)?,
            photos: 0,
            range_m: f64::INFINITY,
        })
    };
    let (width, height) = (known.ranges.width, known.ranges.height);
    let columns = (1..width - 1).step_by(2);
    let pixels = (1..height - 1)
        .step_by(2)
        .flat_map(|row| columns.clone().map(move |column| [column, row]));
    pixels.filter_map(|[column, row]| point(column, row)).collect()
}

/// Counts the photos that show a point.
fn seen(point: TruePoint, photos: &[&Known]) -> TruePoint {
    let mut seen = point;
    let shown = photos.iter().filter_map(|known| known.distances(&point.position));
    for shown in shown.filter(|shown| shown.place_m <= shown.shown_m * (1.0 + SAME)) {
        seen.photos += 1;
        seen.range_m = seen.range_m.min(shown.place_m);
    }
    seen
}

fn cell(position: &Vector3<f64>, side: f64) -> [i32; 3] {
    (position / side).map(|x| x.floor() as i32).into()
}

fn grid<T: Copy>(items: &[T], place: impl Fn(&T) -> Vector3<f64>) -> Grid<T> {
    let mut grid: Grid<T> = HashMap::new();
    for item in items {
        grid.entry(cell(&place(item), CELL_M)).or_default().push(*item);
    }
    grid
}

/// Returns the item nearest to a position, if one is within a cell.
fn nearest<T: Copy>(
    grid: &Grid<T>,
    position: &Vector3<f64>,
    place: impl Fn(&T) -> Vector3<f64>,
) -> Option<(f64, T)> {
    let [x, y, z] = cell(position, CELL_M);
    let mut best: Option<(f64, T)> = None;
    for at in (0..27).map(|n| [x + n % 3 - 1, y + n / 3 % 3 - 1, z + n / 9 - 1]) {
        for item in grid.get(&at).into_iter().flatten() {
            let apart = (place(item) - position).norm();
            if best.is_none_or(|(least, _)| apart < least) {
                best = Some((apart, *item));
            }
        }
    }
    best
}

/// Returns the figures for each range of distances.
fn rows(vertices: &[Vector3<f64>], points: &[TruePoint]) -> Vec<Value> {
    let terrain = grid(points, |point| point.position);
    let of_vertex = |vertex: &Vector3<f64>| match nearest(&terrain, vertex, |point| point.position) {
        // Nothing true within a cell: farther off than any bar, of no known distance.
        None => (f64::INFINITY, None),
        Some((_, point)) => ((vertex - point.position).dot(&point.normal).abs(), Some(point)),
    };
    let judged: Vec<(f64, Option<TruePoint>)> = vertices.par_iter().map(of_vertex).collect();
    let found = grid(vertices, |vertex| *vertex);
    let mut thinned: HashMap<[i32; 3], TruePoint> = HashMap::new();
    for point in points.iter().filter(|point| point.photos >= PHOTOS) {
        thinned.entry(cell(&point.position, APART_M)).or_insert(*point);
    }
    let thinned: Vec<TruePoint> = thinned.into_values().collect();
    let covered: Vec<(f64, bool)> = thinned
        .par_iter()
        .map(|point| {
            let nearest = nearest(&found, &point.position, |vertex| *vertex);
            let is_covered = nearest.is_some_and(|(apart, _)| apart <= COVERED_M);
            (point.range_m, is_covered)
        })
        .collect();
    let off = judged.iter().filter(|(_, point)| point.is_none()).count();
    RANGES_M
        .iter()
        .map(|most| {
            let seen = judged.iter().filter_map(|(apart, point)| {
                let point = (*point)?;
                (point.photos >= PHOTOS && point.range_m <= *most).then_some(*apart)
            });
            let mut seen: Vec<f64> = seen.collect();
            seen.sort_by(f64::total_cmp);
            let near = seen.iter().filter(|apart| **apart <= NEAR_M).count();
            let terrain: Vec<bool> = covered
                .iter()
                .filter(|(range, _)| range <= most)
                .map(|(_, covered)| *covered)
                .collect();
            let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
            json!({
                "within_m": most.is_finite().then_some(*most),
                "vertices": seen.len(),
                "near_share": share(near, seen.len()),
                "median_m": seen.get(seen.len() / 2),
                "p90_m": seen.get(seen.len() * 9 / 10),
                "terrain_points": terrain.len(),
                "covered_share": share(terrain.iter().filter(|covered| **covered).count(), terrain.len()),
                "vertices_in_file": vertices.len(),
                "vertices_far_from_any_terrain": off,
            })
        })
        .collect()
}

/// Reads the positions of the vertices of a PLY.
fn vertices(mut bytes: &[u8]) -> Result<Vec<Vector3<f64>>> {
    let mut ply = Parser::<DefaultElement>::new().read_ply(&mut bytes)?;
    let vertices = ply
        .payload
        .swap_remove("vertex")
        .ok_or("a PLY without vertices")?;
    let number = |vertex: &DefaultElement, name: &str| match vertex.get(name) {
        Some(Property::Float(number)) => Ok(f64::from(*number)),
        _ => Err(format!("a vertex has no float `{name}`")),
    };
    let position = |vertex: &DefaultElement| {
        let [x, y, z] = ["x", "y", "z"].map(|name| number(vertex, name));
        Ok(Vector3::new(x?, y?, z?))
    };
    vertices.iter().map(position).collect()
}
