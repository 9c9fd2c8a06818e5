//! Distances from cameras to the sparse points they see, and how wide a pixel is there.

use marf_numeric::{grouped, quantile};
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::View;
use crate::frame::{ENOUGH_POINTS, FAR, Frame};

/// A point counts as near if this share of the points is nearer, as far if this share is farther: outliers.
const OUTLIERS: f64 = 0.01;
/// Share of the points in view whose pixels may be narrower than the finest cells: close-ups need fine ones.
pub const SHARP: f64 = 0.1;
/// Points whose depths are measured. Percentiles of more are the same.
const MOST_POINTS: usize = 4096;

/// Distances from cameras to the sparse points they see, half sides.
pub struct Depths {
    /// 99 % of the points in view are farther.
    pub nearest: f64,
    /// 99 % of the points in view are nearer.
    pub farthest: f64,
    /// No ray may end nearer than this, or it would not cross the box.
    pub most: f64,
    /// Width of a pixel at the points, half sides of the contracted box: of [`SHARP`] of all it is less, and of half.
    pub footprints: [f64; 2],
}

impl Depths {
    /// Computes the distances from every camera. `Err` is the reason if nothing is known.
    pub fn seen(views: &[View], points: &[[f64; 3]], frame: &Frame) -> Result<Self, String> {
        if points.len() < ENOUGH_POINTS {
            let few = points.len();
            return Err(match few {
                0 => "no sparse points".to_owned(),
                few => format!("{few} sparse points are fewer than the {ENOUGH_POINTS} needed"),
            });
        }
        let stride = points.len().div_ceil(MOST_POINTS);
        let some: Vec<_> = points.iter().step_by(stride).map(|p| Vector3::from(*p)).collect();
        let shrinks: Vec<f64> = some.iter().map(|point| shrink(frame.inward(point))).collect();
        let seen = views.par_iter().map(|view| {
            let seen = some.iter().zip(&shrinks).filter_map(|(point, shrink)| {
                let depth = view.distance_of(point)? / frame.half_side;
                Some((depth, depth / view.camera.fx_px * shrink))
            });
            seen.collect::<Vec<_>>()
        });
        let (depths, footprints): (Vec<f64>, Vec<f64>) =
            seen.collect::<Vec<_>>().into_iter().flatten().unzip();
        if depths.is_empty() {
            return Err(format!(
                "no camera sees any of {} sparse points",
                grouped(points.len() as u64)
            ));
        }
        let share_of = |values: &[f64], share| quantile(values.iter().copied(), share).unwrap_or_default();
        let [nearest, farthest] = [OUTLIERS, 1.0 - OUTLIERS].map(|share| share_of(&depths, share));
        let footprints = [SHARP, 0.5].map(|share| share_of(&footprints, share));
        let away = views.iter().map(|view| {
            let centre = frame.inward(&view.cam_from_world.centre());
            centre.iter().fold(0.0_f64, |most, x| most.max(x.abs()))
        });
        let most = FAR + away.fold(0.0, f64::max);
        Ok(Self {
            nearest,
            farthest,
            most,
            footprints,
        })
    }
}

/// Returns by how much a length across the line to the middle of the box shrinks where space is contracted.
fn shrink(inward: [f64; 3]) -> f64 {
    let m = inward.iter().fold(1.0_f64, |most, x| most.max(x.abs()));
    (2.0 - 1.0 / m) / m
}
