//! Cells, levels and table of the grid.

use marf_numeric::{grouped, upper_median};
use nalgebra::Vector3;

use super::choice::Choice;
use crate::cpu::math::root;
use crate::cpu::space::contract;
use crate::distances::{Depths, SHARP};
use crate::frame::{Frame, MOST_FINEST};
use crate::{Config, View};

/// A level may have this many times the cells a side of the one below. The trilinear corners fill the octave.
const MOST_GROWTH: f64 = 2.0;
/// Sparse points a cell, at least, where cells are counted: fewer, and cells of the surface are missed.
const POINTS_A_CELL: usize = 4;
/// Fewer cells are not a surface: all points are in one place.
const ENOUGH_CELLS: usize = 8;
/// Finest cells an entry may be shared by: the other levels distinguish them (instant-ngp, section 3).
const CELLS_AN_ENTRY: u64 = 4;
/// Smallest and largest table that is derived.
const TABLES: [u32; 2] = [12, 22];

/// Returns the cells a side of the finest level, with the factor of a search.
pub(super) fn finest(
    config: &Config,
    depths: &Result<Depths, String>,
    frame: &Frame,
    views: &[View],
) -> Choice<u32> {
    scaled(finest_asked(config, depths, frame, views), config)
}

pub(super) fn scaled(asked: Choice<u32>, config: &Config) -> Choice<u32> {
    let factor = config.finest_factor;
    if factor == 1.0 {
        return asked;
    }
    let least = f64::from(config.base_resolution);
    let most = f64::from(asked.value.max(MOST_FINEST).max(config.base_resolution));
    let cells = (factor * f64::from(asked.value)).round().clamp(least, most);
    let reason = format!("`finest_factor` is {factor}; {}", asked.reason);
    Choice::new(cells as u32, reason)
}

/// Returns the cells a side that are as wide as a pixel: of the contracted box, which is 4 half sides wide.
fn finest_asked(
    config: &Config,
    depths: &Result<Depths, String>,
    frame: &Frame,
    views: &[View],
) -> Choice<u32> {
    if let Some(finest) = config.finest_resolution {
        return Choice::said(finest, "finest_resolution");
    }
    let (footprint, reason) = match depths {
        Ok(Depths {
            footprints: [near, middle],
            ..
        }) => (
            *near,
            format!(
                "{:.0} % of the sparse points that cameras see have pixels wider than {near:.6} half sides of the contracted box, half of them wider than {middle:.6}",
                100.0 * (1.0 - SHARP)
            ),
        ),
        Err(why) => {
            let focal_px = upper_median(views.iter().map(|view| view.camera.fx_px)).unwrap_or_default();
            let depth = frame.depth / frame.half_side;
            let reason = format!(
                "{why}: a pixel is {:.6} half sides wide at the distance {depth:.4} (focal length {focal_px:.0} px)",
                depth / focal_px
            );
            (depth / focal_px, reason)
        }
    };
    let cells = (4.0 / footprint).ceil().clamp(16.0, f64::from(MOST_FINEST)) as u32;
    Choice::new(cells.max(config.base_resolution), reason)
}

/// Returns the fewest levels whose growth is at most 2, of those that fill blocks of 16 features.
pub(super) fn levels(config: &Config, finest: u32) -> Choice<u32> {
    if let Some(levels) = config.levels {
        return Choice::said(levels, "levels");
    }
    let (base, features) = (config.base_resolution, config.features);
    let growth = |levels: u32| root(f64::from(finest) / f64::from(base), levels - 1);
    let step = 16 / features;
    let allowed = (1..=16 / step).map(|count| count * step);
    // A hair above 2 is 2: the root is found by halving.
    let enough = allowed
        .clone()
        .find(|levels| growth(*levels) <= MOST_GROWTH + 1e-6);
    let levels = enough.unwrap_or(16);
    let mut reason = format!(
        "from {base} to {} cells by {:.2} a level",
        grouped(finest),
        growth(levels)
    );
    if levels > step {
        let fewer = levels - step;
        reason += &format!(
            ". {fewer} levels would grow by {:.2}, more than {MOST_GROWTH}",
            growth(fewer)
        );
    }
    Choice::new(levels, reason)
}

/// Cells of the finest level that hold surface.
///
/// Sparse points are counted by cells as small as they are dense enough for. A surface meets 4 times the
/// cells when their side is halved.
pub(super) fn surface_cells(views: &[View], points: &[[f64; 3]], frame: &Frame, finest: u32) -> Choice<u64> {
    let found = counted(points, frame, finest);
    let surface = found.unwrap_or_else(|| {
        let side = u64::from(finest).div_ceil(2);
        let reason =
            format!("no surface of sparse points: the six faces of the inner box, {side} cells a side");
        Choice::new(6 * side * side, reason)
    });
    let size = |view: &View| u64::from(view.camera.width) * u64::from(view.camera.height);
    let pixels: u64 = views.iter().map(size).sum();
    if surface.value <= pixels {
        return surface;
    }
    Choice::new(
        pixels,
        format!(
            "one a pixel of the photos, fewer than {} ({})",
            grouped(surface.value),
            surface.reason
        ),
    )
}

fn counted(points: &[[f64; 3]], frame: &Frame, finest: u32) -> Option<Choice<u64>> {
    let inside = |point: &[f64; 3]| {
        // Far above any scene and below the end of f32.
        let at = frame
            .inward(&Vector3::from(*point))
            .map(|x| x.clamp(-1e30, 1e30) as f32);
        contract(at).0
    };
    let points: Vec<[f32; 3]> = points.iter().map(inside).collect();
    let cells_of = |side: u32| {
        let cell = |at: &[f32; 3]| at.map(|x| ((x * side as f32) as u32).min(side - 1));
        let mut cells: Vec<[u32; 3]> = points.iter().map(cell).collect();
        cells.sort_unstable();
        cells.dedup();
        cells.len()
    };
    let dense = |side: &u32| points.len() >= POINTS_A_CELL * cells_of(*side);
    let sides = (3..=finest.max(8).ilog2()).map(|log2| 1_u32 << log2);
    let side = sides.take_while(dense).last()?;
    let cells = cells_of(side);
    if cells < ENOUGH_CELLS {
        return None;
    }
    let ratio = f64::from(finest) / f64::from(side);
    let value = (cells as f64 * ratio * ratio).round() as u64;
    let reason = format!(
        "{} sparse points are in {} of {side}^3 cells. The surface through them meets {:.0} times as many of the finest",
        grouped(points.len() as u64),
        grouped(cells as u64),
        ratio * ratio
    );
    Some(Choice::new(value, reason))
}

/// Returns the table, with the shift of a search.
pub(super) fn log2_table(config: &Config, cells: u64, detail: f64) -> Choice<u32> {
    let asked = log2_table_asked(config, cells, detail);
    let shift = config.log2_table_shift;
    if shift == 0 {
        return asked;
    }
    let log2 = asked.value.saturating_add_signed(shift).clamp(8, 24);
    Choice::new(log2, format!("`log2_table_shift` is {shift}: {}", asked.reason))
}

/// Returns the table for four cells of the surface that hold detail an entry, but no more entries than the training has samples to fill.
fn log2_table_asked(config: &Config, cells: u64, detail: f64) -> Choice<u32> {
    if let Some(log2) = config.log2_table {
        return Choice::said(log2, "log2_table");
    }
    let [least, most] = TABLES;
    let detailed = (cells as f64 * detail).ceil() as u64;
    let wanted = detailed
        .div_ceil(CELLS_AN_ENTRY)
        .max(1)
        .next_power_of_two()
        .ilog2();
    let wanted = wanted.clamp(least, most);
    let scene = format!(
        "{} cells of surface, {detail:.3} of them with detail, {CELLS_AN_ENTRY} an entry, want 2^{wanted}",
        grouped(cells)
    );
    let Some(steps) = config.steps else {
        return Choice::new(
            wanted,
            format!("{scene}. The length of the training is not known"),
        );
    };
    let samples = steps.saturating_mul(config.batch_samples.into());
    let filled = log2_filled(samples).clamp(least, most);
    let budget = format!(
        "{} steps of {} samples fill 2^{filled}",
        grouped(steps),
        grouped(config.batch_samples)
    );
    if filled < wanted {
        return Choice::new(filled, format!("the budget decides: {budget}. {scene}"));
    }
    Choice::new(wanted, format!("the scene decides: {scene}. {budget}"))
}

/// Returns the binary logarithm of the table that this many samples fill: 2^15 at 2^23.5 samples, 4 times as
/// large at 8 times as many.
///
/// A larger one has learnt less by then, a smaller one cannot hold more: `benches/size.md`.
fn log2_filled(samples: u64) -> u32 {
    let twice = u128::from(samples.max(1)).pow(2).ilog2();
    twice.saturating_sub(2) / 3
}
