//! A mesh or a cloud with what the views say of each vertex.

use marf_numeric::lowest_joined;
use marf_scene::{Observer, seen_at};
use marf_stage::Cancel;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::SurfaceError;
use crate::cubes::Triangles;
use crate::error::go_on;
use crate::view::SurfaceView;

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// Position, world units.
    pub position: Vector3<f64>,
    /// Unit normal in the world, outward. Zero if unknown.
    pub normal: Vector3<f64>,
    /// sRGB in [0, 1].
    pub color: [f32; 3],
    /// Photos that show it.
    pub photos: u32,
    /// Root mean square of the distances, along the normal, between it and the surfaces that the views show,
    /// world units. Negative if only one view shows it.
    pub spread: f32,
    /// How far the retrainings of a bootstrap differ. `None` without a bootstrap.
    pub retrained: Option<Retrained>,
}

/// Sample standard deviations over the retrainings at a point. Negative if too few show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Retrained {
    /// Of the surface's position along the normal, world units.
    pub depth: f32,
    /// Of the gray of the colour, sRGB in [0, 1].
    pub color: f32,
}

/// Views at a point: means over those with a surface within the band, each by cos² θ / r² as in
/// [`crate::Volume::fuse`].
#[derive(Debug, Clone, Copy)]
pub struct SurfaceSample {
    /// Signed distance from the surface to the point, world units, positive towards the cameras.
    pub signed: f64,
    /// Mean of the squares of the distances.
    square: f64,
    /// sRGB in [0, 1].
    pub color: Vector3<f64>,
    /// Views.
    count: u32,
}

/// A surface as triangles.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// The vertices.
    pub vertices: Vec<Vertex>,
    /// Indices of vertices, counterclockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Views and photos that describe each vertex.
#[derive(Debug, Clone, Copy)]
pub struct Witnesses<'a> {
    /// The field at the views of the photos.
    pub views: &'a [SurfaceView],
    /// How far each photo saw.
    pub observers: &'a [Observer],
    /// Surfaces farther from a vertex are other surfaces, world units.
    pub band: f64,
}

impl Witnesses<'_> {
    /// Returns what the views show at a point. `None` if none shows a surface within the band.
    pub fn at(&self, position: &Vector3<f64>) -> Option<SurfaceSample> {
        let (mut color, mut weights, mut sum, mut squares, mut count) = (Vector3::zeros(), 0.0, 0.0, 0.0, 0);
        for view in self.views {
            let Some((signed, patch, rgb)) = view.at(position) else {
                continue;
            };
            if signed.abs() > self.band {
                continue;
            }
            let share = f64::from(patch.cosine) / f64::from(patch.distance);
            let weight = share * share;
            color += Vector3::from(rgb.map(f64::from)) * weight;
            sum += weight * signed;
            squares += weight * signed * signed;
            weights += weight;
            count += 1;
        }
        (weights > 0.0).then(|| SurfaceSample {
            signed: sum / weights,
            square: squares / weights,
            color: color / weights,
            count,
        })
    }

    /// Returns a point as the views show it, or a grey one if none does.
    pub fn vertex(&self, position: Vector3<f64>, normal: Vector3<f64>) -> Vertex {
        let seen = self.at(&position);
        let color = seen.map_or(Vector3::repeat(0.5), |seen| seen.color);
        Vertex {
            position,
            normal,
            color: color.map(|channel| channel as f32).into(),
            photos: seen_at(self.observers, &position, None).photos,
            spread: match seen {
                Some(seen) if seen.count > 1 => seen.square.sqrt() as f32,
                _ => -1.0,
            },
            retrained: None,
        }
    }
}

impl Mesh {
    /// Gives each vertex of a surface its normal (the mean of its triangles' by area), colour, photos and spread.
    ///
    /// # Errors
    /// The wish to stop.
    pub fn new(surface: Triangles, witnesses: &Witnesses<'_>, cancel: &Cancel) -> Result<Self, SurfaceError> {
        let normals = normals(&surface);
        let vertices = surface.positions.par_iter().zip(&normals);
        Ok(Self {
            vertices: vertices
                .map(|(position, normal)| {
                    go_on(cancel)?;
                    Ok(witnesses.vertex(*position, *normal))
                })
                .collect::<Result<_, SurfaceError>>()?,
            triangles: surface.triangles,
        })
    }

    /// Returns the mesh without triangles with a rejected vertex, and without pieces of fewer triangles than
    /// `least`.
    #[must_use]
    pub fn retaining(mut self, is_kept: impl Fn(&Vertex) -> bool, least: usize) -> Self {
        let vertices = &self.vertices;
        let is_whole = |vertex: &u32| is_kept(&vertices[*vertex as usize]);
        self.triangles.retain(|triangle| triangle.iter().all(is_whole));
        let edges = self.triangles.iter().flat_map(|[a, b, c]| [[a, b], [b, c]]);
        let edges = edges.map(|edge| edge.map(|vertex| *vertex as usize));
        let piece = lowest_joined(vertices.len(), edges);
        let mut size = vec![0_usize; vertices.len()];
        for triangle in &self.triangles {
            size[piece[triangle[0] as usize]] += 1;
        }
        self.triangles
            .retain(|triangle| size[piece[triangle[0] as usize]] >= least);
        self.compacted()
    }

    /// Returns the mesh without vertices that no triangle has, in the same order.
    fn compacted(self) -> Self {
        let mut is_used = vec![false; self.vertices.len()];
        for vertex in self.triangles.iter().flatten() {
            is_used[*vertex as usize] = true;
        }
        let mut next = 0;
        let number = is_used.iter().map(|used| {
            let own = next;
            next += u32::from(*used);
            own
        });
        let number: Vec<u32> = number.collect();
        let kept = self.vertices.iter().zip(&is_used).filter(|(_, used)| **used);
        Self {
            vertices: kept.map(|(vertex, _)| *vertex).collect(),
            triangles: self
                .triangles
                .iter()
                .map(|triangle| triangle.map(|vertex| number[vertex as usize]))
                .collect(),
        }
    }
}

fn normals(surface: &Triangles) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); surface.positions.len()];
    for triangle in &surface.triangles {
        let [a, b, c] = triangle.map(|vertex| surface.positions[vertex as usize]);
        let doubled = (b - a).cross(&(c - a));
        for vertex in triangle {
            sums[*vertex as usize] += doubled;
        }
    }
    sums.iter()
        .map(|sum| sum.try_normalize(0.0).unwrap_or_default())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOBODY: Witnesses<'static> = Witnesses {
        views: &[],
        observers: &[],
        band: 1.0,
    };

    /// Two triangles that share an edge in the plane z = 0, and one apart.
    fn surface() -> Triangles {
        let at = |x: f64, y: f64| Vector3::new(x, y, 0.0);
        Triangles {
            positions: vec![
                at(0.0, 0.0),
                at(1.0, 0.0),
                at(0.0, 1.0),
                at(1.0, 1.0),
                at(5.0, 5.0),
                at(6.0, 5.0),
                at(5.0, 6.0),
            ],
            triangles: vec![[0, 1, 2], [1, 3, 2], [4, 5, 6]],
        }
    }

    fn of_nobody() -> Mesh {
        Mesh::new(surface(), &NOBODY, &Cancel::default()).unwrap()
    }

    #[test]
    fn normals_point_to_where_triangles_run_counterclockwise() {
        let mesh = of_nobody();
        assert!(mesh.vertices.iter().all(|vertex| vertex.normal == Vector3::z()));
        let seen = mesh.vertices[0];
        assert_eq!((seen.photos, seen.spread, seen.color), (0, -1.0, [0.5; 3]));
    }

    #[test]
    fn small_pieces_go_with_their_vertices() {
        let mesh = of_nobody();
        let kept = mesh.clone().retaining(|_| true, 2);
        assert_eq!(
            (kept.vertices.len(), &kept.triangles[..]),
            (4, &mesh.triangles[..2])
        );
        assert_eq!(mesh.clone().retaining(|_| true, 1), mesh);
        assert_eq!(mesh.clone().retaining(|_| true, 3), Mesh::default());
    }

    #[test]
    fn what_no_photo_saw_is_a_hole() {
        assert_eq!(
            of_nobody().retaining(|vertex| vertex.photos > 0, 1),
            Mesh::default()
        );
    }
}
