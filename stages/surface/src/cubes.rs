//! Marching cubes: from signed distances on a grid to triangles.
//!
//! W. Lorensen and H. Cline, Marching Cubes, SIGGRAPH 1987. The table is derived by a rule: on each face of a
//! cube the surface cuts off every corner that is inside by itself. Both cubes of the face agree on this, so
//! there is no crack. The loops are cut into triangles without a diagonal on a face, so an edge never has
//! more than two triangles.

use std::sync::LazyLock;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::SurfaceError;
use crate::volume::{Place, SIDE, Volume, position};

/// Samples along a side of a block with its border.
const WIDE: usize = SIDE + 1;
/// A vertex keeps this share of an edge away from its ends, so that no triangle has sides of no length.
const MARGIN: f64 = 1e-3;

/// The edges of a cube: two corners each, the lower first. Bits of a corner: x, y, z.
const EDGES: [(usize, usize); 12] = [
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (0, 2),
    (1, 3),
    (4, 6),
    (5, 7),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];
/// The corners of each face in a circle, counterclockwise as seen from outside.
const FACES: [[usize; 4]; 6] = [
    [0, 4, 6, 2],
    [1, 3, 7, 5],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 2, 3, 1],
    [4, 5, 7, 6],
];

/// The triangles of each of the 256 ways in which corners are inside: three edges each.
static TRIANGLES: LazyLock<Vec<Vec<[usize; 3]>>> = LazyLock::new(|| (0..256).map(triangles_of).collect());

/// A surface as triangles: positions in world units, triangles counterclockwise as seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Triangles {
    /// `[vertices]`, world units.
    pub positions: Vec<Vector3<f64>>,
    /// `[triangles]`, indices of vertices.
    pub triangles: Vec<[u32; 3]>,
}

/// An edge of the grid: its lower end and its axis.
type Key = (Place, u8);

/// A triangle: the edges of the grid on which its corners lie, and where.
type Corners = [(Key, Vector3<f64>); 3];

/// Returns the surface where the signed distances change from negative (inside) to positive. Cubes with an
/// unknown corner (NaN) have none: the surface ends there.
///
/// Vertices are in the order of their edges, triangles in the order of cubes: the same for any number of threads.
///
/// # Errors
/// [`SurfaceError::NotFinite`] names a sample that is infinite. [`SurfaceError::TooLarge`] with more vertices
/// than u32 can count.
pub fn march(volume: &Volume) -> Result<Triangles, SurfaceError> {
    let of_blocks = volume.places().par_iter().map(|place| march_block(volume, place));
    let of_blocks: Vec<Vec<Corners>> = of_blocks.collect::<Result<_, _>>()?;
    let mut vertices: Vec<(Key, Vector3<f64>)> = of_blocks.iter().flatten().flatten().copied().collect();
    vertices.par_sort_unstable_by_key(|vertex| vertex.0);
    vertices.dedup_by_key(|vertex| vertex.0);
    if u32::try_from(vertices.len()).is_err() {
        return Err(SurfaceError::TooLarge {
            vertices: vertices.len(),
        });
    }
    let number = |key: &Key| {
        vertices
            .binary_search_by_key(key, |vertex| vertex.0)
            .unwrap_or_default() as u32
    };
    let corners: Vec<&Corners> = of_blocks.iter().flatten().collect();
    let triangles = corners
        .par_iter()
        .map(|corners| corners.map(|(key, _)| number(&key)));
    Ok(Triangles {
        triangles: triangles.collect(),
        positions: vertices.into_iter().map(|vertex| vertex.1).collect(),
    })
}

fn march_block(volume: &Volume, block: &Place) -> Result<Vec<Corners>, SurfaceError> {
    let samples = volume.with_border(block);
    let at = |step: [usize; 3]| samples[(step[2] * WIDE + step[1]) * WIDE + step[0]];
    let mut found = Vec::new();
    for index in 0..SIDE * SIDE * SIDE {
        let step = [index % SIDE, index / SIDE % SIDE, index / SIDE / SIDE];
        let corner = |corner: usize| [0, 1, 2].map(|axis| step[axis] + (corner >> axis & 1));
        let values: [f32; 8] = std::array::from_fn(|number| at(corner(number)));
        if values.iter().any(|value| value.is_nan()) {
            continue;
        }
        if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
            return Err(SurfaceError::NotFinite { value: *bad });
        }
        let case = (0..8)
            .filter(|number| values[*number] < 0.0)
            .fold(0, |case, number| case | 1 << number);
        let place = |number: usize| {
            let step = corner(number);
            [0, 1, 2].map(|axis| block[axis] * SIDE as i32 + step[axis] as i32)
        };
        let vertex = |edge: usize| {
            let (low, high) = EDGES[edge];
            let (below, above) = (f64::from(values[low]), f64::from(values[high]));
            let share = (below / (below - above)).clamp(MARGIN, 1.0 - MARGIN);
            let (from, to) = (
                position(volume.cell(), place(low)),
                position(volume.cell(), place(high)),
            );
            let axis = (high ^ low).trailing_zeros() as u8;
            ((place(low), axis), from + (to - from) * share)
        };
        found.extend(TRIANGLES[case].iter().map(|triangle| triangle.map(vertex)));
    }
    Ok(found)
}

/// Returns the triangles of a case: its loops, each cut into triangles.
fn triangles_of(case: usize) -> Vec<[usize; 3]> {
    let mut next = [None; 12];
    for face in FACES {
        for (from, to) in segments(case, face) {
            next[from] = Some(to);
        }
    }
    let mut triangles = Vec::new();
    for start in 0..12 {
        let mut around = Vec::new();
        let mut edge = start;
        while let Some(to) = next[edge].take() {
            around.push(edge);
            edge = to;
        }
        if around.len() >= 3 {
            triangles.extend(cut(&around));
        }
    }
    triangles
}

/// Returns the segments of the surface on a face, from edge to edge, with the inside to the right as seen
/// from outside of the cube. The two cubes of a face run along it in opposite directions.
fn segments(case: usize, face: [usize; 4]) -> Vec<(usize, usize)> {
    let inside = |at: usize| case >> face[at % 4] & 1 == 1;
    let edge = |at: usize| edge_between(face[at % 4], face[(at + 1) % 4]);
    let enters: Vec<usize> = (0..4).filter(|at| !inside(*at) && inside(at + 1)).collect();
    let leaves: Vec<usize> = (0..4).filter(|at| inside(*at) && !inside(at + 1)).collect();
    // Each run of corners inside is cut off by itself: from where it begins to where it ends next.
    let segment = |enter: &usize| {
        let leave = (1..4)
            .map(|step| (enter + step) % 4)
            .find(|at| leaves.contains(at));
        leave.map(|leave| (edge(*enter), edge(leave)))
    };
    enters.iter().filter_map(segment).collect()
}

fn edge_between(a: usize, b: usize) -> usize {
    let ends = (a.min(b), a.max(b));
    EDGES.iter().position(|edge| *edge == ends).unwrap_or_default()
}

/// Cuts a loop into triangles, none of whose diagonals lies on a face of the cube.
fn cut(around: &[usize]) -> Vec<[usize; 3]> {
    if around.len() == 3 {
        return vec![[around[0], around[1], around[2]]];
    }
    let count = around.len();
    for ear in 0..count {
        let (before, after) = (around[(ear + count - 1) % count], around[(ear + 1) % count]);
        if share_a_face(before, after) {
            continue;
        }
        let rest: Vec<usize> = (0..count).filter(|at| *at != ear).map(|at| around[at]).collect();
        let others = cut(&rest);
        if !others.is_empty() {
            return [vec![[before, around[ear], after]], others].concat();
        }
    }
    Vec::new()
}

fn share_a_face(one: usize, other: usize) -> bool {
    let on = |edge: usize, face: &[usize; 4]| face.contains(&EDGES[edge].0) && face.contains(&EDGES[edge].1);
    FACES.iter().any(|face| on(one, face) && on(other, face))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::volume::{SAMPLES, sample_place};

    impl Volume {
        /// Samples a function on all blocks of a box of `blocks` blocks a side, the first at the origin of the
        /// grid. The function returns NaN where it is unknown, else the signed distance in cells, positive
        /// outside.
        fn sampled(cell: f64, blocks: [u32; 3], value: impl Fn(Vector3<f64>) -> f32) -> Self {
            let [nx, ny, nz] = blocks.map(|side| side as i32);
            let mut places: Vec<Place> = Vec::new();
            for x in 0..nx {
                for y in 0..ny {
                    places.extend((0..nz).map(|z| [x, y, z]));
                }
            }
            let of_block = |place: &Place| {
                let mut samples = [f32::NAN; SAMPLES];
                for (index, sample) in samples.iter_mut().enumerate() {
                    *sample = value(position(cell, sample_place(place, index)));
                }
                samples
            };
            let blocks = places.iter().map(of_block).collect();
            Self::from_blocks(cell, places, blocks)
        }
    }

    /// Counts how often each edge is run through from its first vertex to its second.
    fn edges(triangles: &[[u32; 3]]) -> BTreeMap<(u32, u32), u32> {
        let mut count = BTreeMap::new();
        for [a, b, c] in triangles {
            for edge in [(*a, *b), (*b, *c), (*c, *a)] {
                *count.entry(edge).or_default() += 1;
            }
        }
        count
    }

    fn is_closed(triangles: &[[u32; 3]]) -> bool {
        let edges = edges(triangles);
        edges
            .iter()
            .all(|((a, b), count)| *count == 1 && edges.get(&(*b, *a)) == Some(&1))
    }

    /// Signed distances in cells to a ball of a radius in cells around a point.
    fn ball(middle: f64, radius: f64) -> Volume {
        Volume::sampled(0.25, [4; 3], move |at| {
            ((at / 0.25 - Vector3::repeat(middle)).norm() - radius) as f32
        })
    }

    #[test]
    fn every_case_has_as_many_triangles_as_its_loops_ask_for() {
        for (case, triangles) in TRIANGLES.iter().enumerate() {
            let crossed = EDGES
                .iter()
                .filter(|(a, b)| (case >> a ^ case >> b) & 1 == 1)
                .count();
            let mut used: Vec<usize> = triangles.iter().flatten().copied().collect();
            used.sort_unstable();
            used.dedup();
            assert_eq!(used.len(), crossed, "case {case}");
            assert_eq!(crossed == 0, triangles.is_empty(), "case {case}");
        }
        // One corner: a triangle whose normal points away from it.
        assert_eq!(TRIANGLES[1].len(), 1);
    }

    #[test]
    fn a_ball_becomes_a_closed_sphere_of_its_radius_with_euler_characteristic_2() {
        let mesh = march(&ball(15.3, 9.7)).unwrap();
        let middle = Vector3::repeat(15.3 * 0.25);
        for position in &mesh.positions {
            let radius = (position - middle).norm() / 0.25;
            // Linear between samples: at most 1 / (8 r) of a cell off.
            assert!((radius - 9.7).abs() < 0.02, "{radius}");
        }
        assert!(is_closed(&mesh.triangles));
        let edges = edges(&mesh.triangles).len() / 2;
        assert_eq!(mesh.positions.len() + mesh.triangles.len() - edges, 2);
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|vertex| mesh.positions[vertex as usize]);
            let normal = (b - a).cross(&(c - a));
            assert!(normal.dot(&(a - middle)) > 0.0, "outward");
        }
    }

    /// Corners inside and outside without order: every case and every ambiguous face occurs.
    #[test]
    fn noise_becomes_a_surface_without_cracks() {
        let value = |at: Vector3<f64>| {
            let place = at.map(|x| (x / 0.25).round() as i64);
            let border = place.iter().any(|x| *x < 1 || *x > 22);
            let hash = (place.x * 73_856_093) ^ (place.y * 19_349_663) ^ (place.z * 83_492_791);
            let mixed = (hash as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
            if border {
                1.0
            } else {
                (mixed % 2000) as f32 / 1000.0 - 1.0005
            }
        };
        let mesh = march(&Volume::sampled(0.25, [3; 3], value)).unwrap();
        assert!(mesh.triangles.len() > 10_000, "{}", mesh.triangles.len());
        assert!(is_closed(&mesh.triangles));
    }

    #[test]
    fn nothing_and_everything_and_what_is_not_known_have_no_surface() {
        for value in [1.0, -1.0, f32::NAN] {
            let mesh = march(&Volume::sampled(1.0, [2; 3], |_| value)).unwrap();
            assert_eq!(mesh, Triangles::default(), "{value}");
        }
        assert_eq!(
            march(&Volume::sampled(1.0, [0; 3], |_| 1.0)).unwrap(),
            Triangles::default()
        );
        let error = march(&Volume::sampled(1.0, [1; 3], |_| f32::INFINITY)).unwrap_err();
        assert!(error.to_string().contains("inf"), "{error}");
    }

    #[test]
    fn one_corner_inside_of_one_cube_is_an_octahedron_and_one_unknown_sample_is_a_hole() {
        let corner = |at: Vector3<f64>| if at == Vector3::repeat(3.0) { -1.0 } else { 1.0 };
        let whole = march(&Volume::sampled(1.0, [1; 3], corner)).unwrap();
        assert_eq!((whole.positions.len(), whole.triangles.len()), (6, 8));
        assert!(
            whole
                .positions
                .iter()
                .all(|at| ((at - Vector3::repeat(3.0)).norm() - 0.5).abs() < 1e-9)
        );
        let open = march(&Volume::sampled(1.0, [1; 3], |at| {
            if at == Vector3::repeat(4.0) {
                f32::NAN
            } else {
                corner(at)
            }
        }));
        assert_eq!(open.unwrap().triangles.len(), 7);
    }

    #[test]
    fn the_same_for_one_thread_and_four() {
        let volume = ball(15.3, 9.7);
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| march(&volume).unwrap())
        };
        assert_eq!(with(1), with(4));
    }
}
