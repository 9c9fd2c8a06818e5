//! From views of a field to its surface: mesh and cloud at a resolution that follows from the scene.

use marf_scene::Observer;

use crate::SurfaceError;
use crate::cloud::cloud;
use crate::cubes::march;
use crate::mesh::{Mesh, Vertex, Witnesses};
use crate::view::SurfaceView;
use crate::volume::{Layout, Volume};

/// Share of the pixels that the cell follows from.
const FINER: f64 = 0.25;
/// Pixels of that width a cell: where a field is as fine as its photos, less than that is noise.
const PIXELS: f64 = 2.0;
/// Cells a pixel may be wide: what is farther away is too coarse for the grid.
const COARSEST: f64 = 4.0;
/// Width of the band around a surface, cells.
const BAND: f64 = 4.0;
/// Most blocks of 8 x 8 x 8 samples, 2 KB each: about 8 million triangles.
const MOST_BLOCKS: usize = 200_000;
/// Factor to the next cell where the blocks are too many: half the number.
const COARSER: f64 = 1.26;
/// Smaller pieces are taken for floating matter.
const LEAST_TRIANGLES: usize = 100;

/// How a surface is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// Distance between samples, world units; none: from the footprints of the pixels.
    pub cell: Option<f64>,
    /// Largest distance from a photo to what is taken from it, world units; none: where a pixel is four cells wide.
    pub reach: Option<f64>,
    /// Photos that must show a point.
    pub least_photos: u32,
    /// Largest spread of a point ([`Vertex::spread`]), world units; none: a cell. What one view alone shows has none and is left out.
    pub most_spread: Option<f64>,
}

/// A surface, and what it was made with.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// The mesh.
    pub mesh: Mesh,
    /// The cloud.
    pub points: Vec<Vertex>,
    /// Distance between samples, world units.
    pub cell: f64,
    /// Width of the band to each side of a surface, world units.
    pub band: f64,
    /// Largest distance from a photo, world units.
    pub reach: f64,
    /// Largest spread of a vertex, world units.
    pub most_spread: f64,
}

/// Makes mesh and cloud of what the views show.
///
/// The cell is twice the width of a pixel on the surface, at the quartile of the finest over all views, unless it is given; where it gives
/// more blocks than fit into memory, it is widened by 26 % until they do. One that is given and too fine is refused.
///
/// # Errors
/// [`SurfaceError::NoSurface`] without a pixel that shows one; those of [`Volume::fuse`] and [`march`].
pub fn extract(
    views: &[SurfaceView],
    observers: &[Observer],
    wanted: Wanted,
) -> Result<Surface, SurfaceError> {
    let no_surface = || SurfaceError::NoSurface { photos: views.len() };
    let mut cell = match wanted.cell {
        Some(cell) => cell,
        None => PIXELS * quartile(views).ok_or_else(no_surface)?,
    };
    let angle = views
        .iter()
        .map(SurfaceView::pixel_angle)
        .fold(f64::INFINITY, f64::min);
    loop {
        let layout = Layout {
            cell,
            band: BAND * cell,
            most_blocks: MOST_BLOCKS,
        };
        let reach = wanted.reach.unwrap_or(COARSEST * cell / angle);
        let volume = match Volume::fuse(views, layout, reach) {
            Err(SurfaceError::TooFine { .. }) if wanted.cell.is_none() => {
                cell *= COARSER;
                continue;
            }
            volume => volume?,
        };
        let witnesses = Witnesses {
            views,
            observers,
            band: layout.band,
        };
        let most_spread = wanted.most_spread.unwrap_or(cell);
        let is_kept = |vertex: &Vertex| {
            let spread = f64::from(vertex.spread);
            vertex.photos >= wanted.least_photos && (0.0..=most_spread).contains(&spread)
        };
        let mesh = Mesh::new(march(&volume)?, &witnesses);
        let mut points = cloud(&witnesses, cell, reach);
        points.retain(is_kept);
        return Ok(Surface {
            mesh: mesh.retaining(is_kept, LEAST_TRIANGLES),
            points,
            most_spread,
            cell,
            band: layout.band,
            reach,
        });
    }
}

/// Returns the width of a pixel on the surface that a quarter of all pixels stay below, world units; none without a surface.
fn quartile(views: &[SurfaceView]) -> Option<f64> {
    let mut widths: Vec<f32> = Vec::new();
    for view in views {
        let angle = view.pixel_angle() as f32;
        widths.extend(view.points().map(|(_, patch, _)| patch.distance * angle));
    }
    let place = (widths.len() as f64 * FINER) as usize;
    (place < widths.len()).then(|| f64::from(*widths.select_nth_unstable_by(place, f32::total_cmp).1))
}
