//! A dense cloud of points: what the pixels of the views show, one point a cell.

use marf_stage::Cancel;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::SurfaceError;
use crate::error::go_on;
use crate::mesh::{Vertex, Witnesses};
use crate::view::SurfaceView;
use crate::volume::Place;

/// Pixels of a cell: sums of position and normal by weight.
#[derive(Debug, Clone, Copy)]
struct Sum {
    place: Place,
    position: Vector3<f64>,
    normal: Vector3<f64>,
    weight: f64,
}

/// Returns a point for every cell in which pixels of the views show a surface: the mean of these pixels, each
/// by cos² θ / r² as in [`crate::Volume::fuse`]. Pixels farther than `reach` from their photo (world units)
/// are left out.
///
/// In the order of the cells: the same for any number of threads.
///
/// # Errors
/// The wish to stop.
pub fn cloud(
    witnesses: &Witnesses<'_>,
    cell: f64,
    reach: f64,
    cancel: &Cancel,
) -> Result<Vec<Vertex>, SurfaceError> {
    let of_views = witnesses.views.par_iter().map(|view| {
        go_on(cancel)?;
        Ok(sums(view, cell, reach))
    });
    let mut all: Vec<Sum> = of_views.collect::<Result<Vec<_>, SurfaceError>>()?.concat();
    // Stable: within a cell in the order of the views.
    all.par_sort_by_key(|sum| sum.place);
    let merged = merged(&all);
    let vertices = merged.par_iter().map(|sum| {
        go_on(cancel)?;
        let normal = sum.normal.try_normalize(1e-9).unwrap_or_default();
        Ok(witnesses.vertex(sum.position / sum.weight, normal))
    });
    vertices.collect()
}

fn sums(view: &SurfaceView, cell: f64, reach: f64) -> Vec<Sum> {
    let near = view
        .points()
        .filter(|(_, patch, _)| f64::from(patch.distance) <= reach);
    let mut all: Vec<Sum> = near
        .map(|(point, patch, _)| {
            let share = f64::from(patch.cosine) / f64::from(patch.distance);
            let weight = share * share;
            Sum {
                place: (point / cell).map(|x| x.floor() as i32).into(),
                position: point * weight,
                normal: Vector3::from(patch.normal.map(f64::from)) * weight,
                weight,
            }
        })
        .collect();
    all.sort_by_key(|sum| sum.place);
    merged(&all)
}

/// Adds up neighbours of one cell, in order.
fn merged(sorted: &[Sum]) -> Vec<Sum> {
    let cells = sorted.chunk_by(|a, b| a.place == b.place);
    let add = |cell: &[Sum]| {
        let first = Sum {
            position: Vector3::zeros(),
            normal: Vector3::zeros(),
            weight: 0.0,
            ..cell[0]
        };
        cell.iter().fold(first, |sum, one| Sum {
            position: sum.position + one.position,
            normal: sum.normal + one.normal,
            weight: sum.weight + one.weight,
            ..sum
        })
    };
    cells.map(add).collect()
}
