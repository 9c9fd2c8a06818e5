//! Distances along rays to the points of a cloud, beside what a field says.

use marf_numeric::upper_median;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::cloud::{CloudPoint, POINT_BYTES, SPACING};

/// A point counts if the ray passes it within this many cells, or within this many pixels of the picture.
const NEAR_CELLS: f64 = 1.5;
const NEAR_PX: f64 = 2.0;
/// Fewest points that are a surface. One or two may be wrong matches.
const LEAST_POINTS: usize = 3;
/// Least cosine between a ray and a normal: the plane of a flatter point meets the ray anywhere.
const LEAST_COSINE: f64 = 0.1;

/// A cloud of points with normals, in units of the world.
#[derive(Debug)]
pub struct PointCloud {
    /// Distance between points.
    pub(crate) cell: f64,
    pub(crate) points: Vec<CloudPoint>,
}

/// A ray into the world.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Where it begins.
    pub origin: Vector3<f64>,
    /// Unit vector.
    pub direction: Vector3<f64>,
    /// Angle of a pixel, radians.
    pub pixel: f64,
}

/// A surface that a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudDistance {
    /// Distance along the ray, units of the world.
    pub distance: f64,
    /// One standard deviation.
    pub sigma: f64,
}

impl PointCloud {
    /// Reads the PLY file of a cloud, of a scene with `scale` metres a unit of the world. `None` if it is anything else.
    pub fn decode(bytes: &[u8], scale: f64) -> Option<Self> {
        const END: &[u8] = b"end_header\n";
        let body = bytes.windows(END.len()).position(|line| line == END)? + END.len();
        let (header, body) = bytes.split_at(body);
        let header = std::str::from_utf8(header).ok()?;
        let spacing = header
            .lines()
            .find_map(|line| line.strip_prefix("comment ")?.strip_prefix(SPACING))?;
        let (records, []) = body.as_chunks::<POINT_BYTES>() else {
            return None;
        };
        let points = records.iter().map(|record| {
            let float = |at: usize| f64::from(f32::from_le_bytes([0, 1, 2, 3].map(|byte| record[at + byte])));
            let vector = |at: usize| Vector3::new(float(at), float(at + 4), float(at + 8));
            CloudPoint {
                position: vector(0) / scale,
                normal: vector(12),
                color: [record[24], record[25], record[26]],
                photos: u16::from_le_bytes([record[27], record[28]]),
                sigma: float(29) / scale,
            }
        });
        Some(Self {
            cell: spacing.parse::<f64>().ok()? / scale,
            points: points.collect(),
        })
    }

    /// Returns where a ray meets a surface of the cloud: the one that is nearest to the distance `expected`, or the first.
    ///
    /// Points near the ray are continued along their planes. Those without a gap between their distances are a surface, which is at
    /// their median. Their errors are those of the same pairs, so the standard deviation is the median of theirs, and no smaller.
    pub fn along(&self, ray: &Ray, expected: Option<f64>) -> Option<CloudDistance> {
        let met = |point: &CloudPoint| {
            let to = point.position - ray.origin;
            let along = to.dot(&ray.direction);
            let near = (NEAR_CELLS * self.cell).max(NEAR_PX * ray.pixel * along);
            let is_near = along > 0.0 && (to - ray.direction * along).norm_squared() <= near * near;
            let cosine = point.normal.dot(&ray.direction);
            if !is_near || cosine.abs() < LEAST_COSINE {
                return None;
            }
            let distance = point.normal.dot(&to) / cosine;
            (distance > 0.0).then_some(CloudDistance {
                distance,
                sigma: point.sigma,
            })
        };
        let mut found: Vec<CloudDistance> = self.points.par_iter().filter_map(met).collect();
        found.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        let is_together = |a: &CloudDistance, b: &CloudDistance| {
            let gap = (NEAR_CELLS * self.cell).max(NEAR_PX * ray.pixel * a.distance);
            b.distance - a.distance <= 2.0 * gap.max(a.sigma)
        };
        let surfaces = found
            .chunk_by(is_together)
            .filter(|all| all.len() >= LEAST_POINTS);
        let surfaces = surfaces.map(|all| {
            let median =
                |value: fn(&CloudDistance) -> f64| upper_median(all.iter().map(value)).unwrap_or_default();
            CloudDistance {
                distance: median(|one| one.distance),
                sigma: median(|one| one.sigma),
            }
        });
        let off = |surface: &CloudDistance| {
            expected.map_or(surface.distance, |expected| (surface.distance - expected).abs())
        };
        surfaces.min_by(|a, b| off(a).total_cmp(&off(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of points at distance `z` that faces the camera, tilted by a slope in x.
    fn wall(z: f64, slope: f64) -> Vec<CloudPoint> {
        let normal = Vector3::new(slope, 0.0, -1.0).normalize();
        let point = |place: i32| {
            let [x, y] = [place % 21 - 10, place / 21 - 10].map(|cells| 0.1 * f64::from(cells));
            CloudPoint {
                position: Vector3::new(x, y, z + slope * x),
                normal,
                color: [0; 3],
                photos: 2,
                sigma: 0.02,
            }
        };
        (0..21 * 21).map(point).collect()
    }

    fn straight(x: f64) -> Ray {
        Ray {
            origin: Vector3::new(x, 0.03, 0.0),
            direction: Vector3::z(),
            pixel: 0.001,
        }
    }

    #[test]
    fn a_ray_between_points_meets_their_plane() {
        let cloud = PointCloud {
            cell: 0.1,
            points: wall(4.0, 0.5),
        };
        let found = cloud.along(&straight(0.26), None).unwrap();
        assert!((found.distance - 4.13).abs() < 1e-9, "{found:?}");
        assert_eq!(found.sigma, 0.02);
        assert_eq!(cloud.along(&straight(3.0), None), None, "beside the wall");
        let back = Ray {
            direction: -Vector3::z(),
            ..straight(0.0)
        };
        assert_eq!(cloud.along(&back, None), None, "behind the camera");
    }

    #[test]
    fn of_two_surfaces_the_first_is_met_or_the_one_that_is_expected() {
        let mut points = wall(4.0, 0.0);
        points.extend(wall(6.0, 0.0));
        let cloud = PointCloud { cell: 0.1, points };
        let at = |expected| cloud.along(&straight(0.0), expected).map(|found| found.distance);
        assert_eq!(at(None), Some(4.0));
        assert_eq!(at(Some(5.5)), Some(6.0));
    }

    #[test]
    fn two_points_are_no_surface() {
        let points = wall(4.0, 0.0).into_iter().take(2).collect();
        let cloud = PointCloud { cell: 100.0, points };
        assert_eq!(cloud.along(&straight(-1.0), None), None);
        let empty = PointCloud {
            cell: 1.0,
            points: Vec::new(),
        };
        assert_eq!(empty.along(&straight(0.0), None), None);
    }
}
