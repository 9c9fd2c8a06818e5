//! From views of a field to its surface: mesh and cloud at a resolution that follows from the scene.

use marf_scene::Observer;
use marf_stage::Cancel;

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
/// Cells a pixel may be wide: farther surfaces are too coarse for the grid.
const COARSEST: f64 = 4.0;
/// Width of the band around a surface, cells.
const BAND: f64 = 4.0;
/// Most blocks of 8 x 8 x 8 samples, 2 KB each: about 8 million triangles.
const MOST_BLOCKS: usize = 200_000;
/// Factor to the next cell where the blocks are too many: half the number.
const COARSER: f64 = 1.26;
/// Smaller pieces are taken for floating matter.
const LEAST_TRIANGLES: usize = 100;

/// Limits of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceLimits {
    /// Distance between samples, world units. `None`: from the footprints of the pixels.
    pub cell: Option<f64>,
    /// Largest distance from a photo to a surface taken from it, world units. `None`: where a pixel is four
    /// cells wide.
    pub reach: Option<f64>,
    /// Photos that must show a point.
    pub least_photos: u32,
    /// Largest spread of a point ([`Vertex::spread`]), world units. `None`: a cell. A point that only one
    /// view shows has no spread and is left out.
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
/// Without a given cell, the cell is twice the width of a pixel on the surface, at the quartile of the finest
/// over all views. If it gives more blocks than fit into memory, it is widened by 26 % until they do. A given
/// cell that is too fine is refused.
///
/// # Errors
/// [`SurfaceError::NoSurface`] without a pixel that shows one. Those of [`Volume::fuse`] and [`march`]. The
/// wish to stop.
pub fn extract(
    views: &[SurfaceView],
    observers: &[Observer],
    limits: SurfaceLimits,
    cancel: &Cancel,
) -> Result<Surface, SurfaceError> {
    let no_surface = || SurfaceError::NoSurface { photos: views.len() };
    let mut cell = match limits.cell {
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
        let reach = limits.reach.unwrap_or(COARSEST * cell / angle);
        let volume = match Volume::fuse(views, layout, reach, cancel) {
            Err(SurfaceError::TooFine { .. }) if limits.cell.is_none() => {
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
        let most_spread = limits.most_spread.unwrap_or(cell);
        let is_kept = |vertex: &Vertex| {
            let spread = f64::from(vertex.spread);
            vertex.photos >= limits.least_photos && (0.0..=most_spread).contains(&spread)
        };
        let mesh = Mesh::new(march(&volume)?, &witnesses, cancel)?;
        let mut points = cloud(&witnesses, cell, reach, cancel)?;
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

/// Returns the width of a pixel on the surface that a quarter of all pixels stay below, world units. `None`
/// without a surface.
fn quartile(views: &[SurfaceView]) -> Option<f64> {
    let mut widths: Vec<f32> = Vec::new();
    for view in views {
        let angle = view.pixel_angle() as f32;
        widths.extend(view.points().map(|(_, patch, _)| patch.distance * angle));
    }
    let place = (widths.len() as f64 * FINER) as usize;
    (place < widths.len()).then(|| f64::from(*widths.select_nth_unstable_by(place, f32::total_cmp).1))
}

#[cfg(test)]
mod tests {
    use marf_scene::{Camera, Pose, Scene};
    use nalgebra::{Vector2, Vector3};

    use super::*;
    use crate::{ExportFrame, glb, ply};

    const WANTED: SurfaceLimits = SurfaceLimits {
        cell: Some(0.05),
        reach: None,
        least_photos: 2,
        most_spread: None,
    };

    /// Height of the floor, between samples of the grid.
    const FLOOR: f64 = 0.017;

    /// A camera 2 above the floor of the world (z up) that looks straight down. `error` moves its distances.
    fn above(x: f64, error: f64) -> (SurfaceView, Observer) {
        let camera = Camera::pinhole(80, 60, 60.0);
        let eye = Vector3::new(x, 0.0, FLOOR + 2.0);
        let pose = Pose::looking_at(eye, Vector3::new(x, 0.0, 0.0), Vector3::y());
        let pixels = (0..60)
            .flat_map(|row| (0..80).map(move |column| (f64::from(column) + 0.5, f64::from(row) + 0.5)));
        let distance: Vec<f32> = pixels
            .map(|(column, row)| {
                let ray = camera.unproject(&Vector2::new(column, row)).unwrap();
                (ray.norm() * (2.0 + error)) as f32
            })
            .collect();
        let view = SurfaceView::new(camera, pose, &distance, vec![[0.2, 0.4, 0.6]; distance.len()]);
        (view, Observer::new(camera, pose, &distance))
    }

    fn surface(of: &[(f64, f64)], limits: SurfaceLimits) -> Result<Surface, SurfaceError> {
        let (views, observers): (Vec<_>, Vec<_>) = of.iter().map(|(x, error)| above(*x, *error)).unzip();
        extract(&views, &observers, limits, &Cancel::default())
    }

    /// However often a surface has looked at the wish to stop, it stops at the next look.
    #[test]
    fn it_stops_wherever_it_is() {
        let (views, observers): (Vec<_>, Vec<_>) = [above(0.0, 0.0), above(1.0, 0.0)].into_iter().unzip();
        let stopped_after = |looks: u64| extract(&views, &observers, WANTED, &Cancel::after(looks));
        let mut looks = 0;
        while let Err(error) = stopped_after(looks) {
            assert!(matches!(error, SurfaceError::Cancelled), "{looks}: {error}");
            looks = 2 * looks + 1;
        }
        // Two views, blocks, vertices and points.
        assert!(looks > 1000, "{looks}");
    }

    #[test]
    fn a_floor_that_two_photos_see_comes_back_with_normals_up_and_ends_where_one_sees_it() {
        let Surface { mesh, points, .. } = surface(&[(0.0, 0.0), (1.0, 0.0)], WANTED).unwrap();
        assert!(mesh.triangles.len() > 500 && points.len() > 500);
        for vertex in mesh.vertices.iter().chain(&points) {
            assert!((vertex.position.z - FLOOR).abs() < 1e-3, "{}", vertex.position);
            assert!((vertex.normal - Vector3::z()).norm() < 1e-2, "{}", vertex.normal);
            // Each photo shows 4/3 to both sides: both show -1/3 to 4/3.
            assert!((-0.34..=1.34).contains(&vertex.position.x), "{}", vertex.position);
            assert_eq!(vertex.photos, 2);
            assert!((vertex.color[2] - 0.6).abs() < 1e-6);
        }
    }

    #[test]
    fn photos_that_differ_more_than_allowed_leave_a_hole_and_tell_by_how_much() {
        let of = [(0.0, 0.04), (0.0, -0.04)];
        let narrow = SurfaceLimits {
            most_spread: Some(0.03),
            ..WANTED
        };
        assert_eq!(surface(&of, narrow).unwrap().mesh, Mesh::default());
        let Surface { mesh, .. } = surface(&of, WANTED).unwrap();
        assert!(!mesh.triangles.is_empty());
        for vertex in &mesh.vertices {
            assert!(
                (vertex.position.z - FLOOR).abs() < 2e-3,
                "in the middle: {}",
                vertex.position
            );
            assert!((vertex.spread - 0.04).abs() < 2e-3, "{}", vertex.spread);
        }
    }

    #[test]
    fn nothing_seen_is_refused_and_one_photo_alone_leaves_nothing() {
        let none = surface(&[], SurfaceLimits { cell: None, ..WANTED }).unwrap_err();
        assert_eq!(
            none.to_string(),
            "the field shows no surface at the views of its 0 photos"
        );
        assert_eq!(surface(&[], WANTED).unwrap().mesh, Mesh::default());
        assert_eq!(surface(&[(0.0, 0.0)], WANTED).unwrap().mesh, Mesh::default());
    }

    #[test]
    fn cells_that_are_no_length_or_too_many_are_refused() {
        for cell in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let error = surface(
                &[(0.0, 0.0)],
                SurfaceLimits {
                    cell: Some(cell),
                    ..WANTED
                },
            )
            .unwrap_err();
            let said = format!("cells of {cell} and a band of ");
            assert!(
                error.to_string().starts_with(&said)
                    && error.to_string().ends_with(" make no grid for this scene"),
                "{cell}: {error}"
            );
        }
        let error = surface(
            &[(0.0, 0.0)],
            SurfaceLimits {
                cell: Some(1e-3),
                reach: Some(9.0),
                ..WANTED
            },
        )
        .unwrap_err();
        let said = error.to_string();
        let words: Vec<f64> = said.split(' ').filter_map(|word| word.parse().ok()).collect();
        let [cell, blocks, most] = words[..] else {
            panic!("{said}")
        };
        assert!(
            cell == 1e-3 && blocks >= most && said.ends_with("are taken"),
            "{said}"
        );
    }

    #[test]
    fn the_same_bytes_for_one_thread_and_three() {
        let frame = ExportFrame::new(&Scene::default());
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| {
                let found = surface(&[(0.0, 0.01), (0.4, -0.01), (1.0, 0.0)], WANTED).unwrap();
                [
                    ply::mesh(&found.mesh, &frame, &[]),
                    ply::points(&found.points, &frame, &[]),
                    glb::mesh(&found.mesh, &frame, "test", ""),
                ]
            })
        };
        assert!(with(1) == with(3));
    }
}
