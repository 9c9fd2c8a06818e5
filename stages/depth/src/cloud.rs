//! One cloud of the depths of all photos: a point for each cell of a grid in which they show a surface.

use std::collections::HashMap;

use marf_scene::ply::{HeaderWriter, push_float};
use marf_surface::ExportFrame;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::surfels::Surfel;

/// Most points. With more, cells get twice as wide.
const MOST_POINTS: usize = 2_000_000;
/// Cells from the origin at most.
const FARTHEST: f64 = 1e9;

type Place = [i32; 3];

/// What a cell holds: sums over photos, each of which counts by its mean weight.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    position: Vector3<f64>,
    normal: Vector3<f32>,
    color: Vector3<f32>,
    weight: f64,
    /// Pixels. Of a photo, its weights are divided by it.
    pixels: f64,
    photos: u16,
    confirmed: bool,
}

impl Cell {
    fn add(&mut self, other: &Self) {
        self.position += other.position;
        self.normal += other.normal;
        self.color += other.color;
        self.weight += other.weight;
        self.pixels += other.pixels;
        self.photos = self.photos.saturating_add(other.photos);
        self.confirmed |= other.confirmed;
    }

    /// Returns the cell with this share of its weight.
    fn of_weight(self, share: f64) -> Self {
        Self {
            position: self.position * share,
            normal: self.normal * share as f32,
            color: self.color * share as f32,
            weight: self.weight * share,
            ..self
        }
    }
}

/// A cloud that grows photo by photo.
pub(crate) struct Cloud {
    /// Width of a cell, units of the world.
    pub cell: f64,
    cells: HashMap<Place, Cell>,
}

/// A point of the cloud, in units of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CloudPoint {
    pub position: Vector3<f64>,
    /// Unit normal, towards the cameras.
    pub normal: Vector3<f64>,
    pub color: [u8; 3],
    /// Photos that show it.
    pub photos: u16,
    /// One standard deviation along the ray.
    pub sigma: f64,
}

impl Cloud {
    pub fn new(cell: f64) -> Self {
        Self {
            cell,
            cells: HashMap::new(),
        }
    }

    /// Adds the points of a photo.
    pub fn add(&mut self, surfels: &[Surfel]) {
        let cell = self.cell;
        let mut placed: Vec<(Place, Cell)> = surfels.par_iter().filter_map(|one| placed(one, cell)).collect();
        // Stable: within a cell in the order of the pixels.
        placed.par_sort_by_key(|(place, _)| *place);
        for same in placed.chunk_by(|a, b| a.0 == b.0) {
            let mut sum = Cell::default();
            same.iter().for_each(|(_, one)| sum.add(one));
            // Pixels of one photo share their errors: together they count as one of their mean weight.
            let of_photo = Cell {
                photos: 1,
                ..sum.of_weight(1.0 / sum.pixels)
            };
            self.cells.entry(same[0].0).or_default().add(&of_photo);
        }
        while self.cells.len() > MOST_POINTS {
            self.coarsen();
        }
    }

    /// Makes the cells twice as wide. The same photos show the parts of one, with the same errors: they count as they would in one cell.
    fn coarsen(&mut self) {
        self.cell *= 2.0;
        let mut coarse: HashMap<Place, (Cell, f64)> = HashMap::new();
        let mut fine: Vec<(Place, Cell)> = std::mem::take(&mut self.cells).into_iter().collect();
        fine.par_sort_by_key(|(place, _)| *place);
        for (place, cell) in fine {
            let (known, shown) = coarse.entry(place.map(|x| x >> 1)).or_default();
            let photos = known.photos.max(cell.photos);
            known.add(&cell);
            known.photos = photos;
            *shown += f64::from(cell.photos);
        }
        let whole = |(cell, shown): (Cell, f64)| cell.of_weight(f64::from(cell.photos) / shown);
        self.cells = coarse
            .into_iter()
            .map(|(place, parts)| (place, whole(parts)))
            .collect();
    }

    /// Returns the points, in the order of their cells. Of a cloud with confirmed points, those of one photo that no other confirms
    /// are left out.
    pub fn points(self) -> Vec<CloudPoint> {
        let mut cells: Vec<(Place, Cell)> = self.cells.into_iter().collect();
        let is_firm = |cell: &Cell| cell.confirmed || cell.photos > 1;
        if cells.iter().any(|(_, cell)| is_firm(cell)) {
            cells.retain(|(_, cell)| is_firm(cell));
        }
        cells.par_sort_by_key(|(place, _)| *place);
        let point = |(_, cell): &(Place, Cell)| CloudPoint {
            position: cell.position / cell.weight,
            normal: cell.normal.cast::<f64>().try_normalize(1e-9).unwrap_or_default(),
            color: (cell.color / cell.weight as f32)
                .map(|channel| channel.round().clamp(0.0, 255.0) as u8)
                .into(),
            photos: cell.photos,
            // A pair gives its disparities to both of its photos, so their weights hold each pair twice.
            sigma: (f64::from(cell.photos.min(2)) / cell.weight).sqrt(),
        };
        cells.par_iter().map(point).collect()
    }
}

fn placed(surfel: &Surfel, cell: f64) -> Option<(Place, Cell)> {
    let place = surfel.position / cell;
    if !place.iter().all(|x| x.abs() < FARTHEST) {
        return None;
    }
    let weight = 1.0 / (surfel.sigma * surfel.sigma);
    let sums = Cell {
        position: surfel.position * weight,
        normal: surfel.normal.cast::<f32>() * weight as f32,
        color: Vector3::from(surfel.color.map(f32::from)) * weight as f32,
        weight,
        pixels: 1.0,
        photos: 0,
        confirmed: surfel.confirmed,
    };
    Some((place.map(|x| x.floor() as i32).into(), sums))
}

/// Returns points as binary PLY in the unit of exports: x, y, z, nx, ny, nz (float), red, green, blue (uchar, sRGB), photos (ushort),
/// sigma (float: one standard deviation along the ray).
pub(crate) fn ply(points: &[CloudPoint], frame: &ExportFrame, cell: f64) -> Vec<u8> {
    let scale = frame.scale();
    let comments = [
        "points of pairs of photos by semi-global matching, without a field".to_owned(),
        format!("{SPACING}{}", cell * scale),
        "photos: those that show the point; sigma: one standard deviation along the ray".to_owned(),
    ];
    let header = HeaderWriter::new(&marf_surface::ply::with_frame(frame, &comments))
        .element("vertex", points.len())
        .properties("float", &["x", "y", "z", "nx", "ny", "nz"])
        .properties("uchar", &["red", "green", "blue"])
        .properties("ushort", &["photos"])
        .properties("float", &["sigma"]);
    let mut bytes = header.into_bytes();
    for point in points {
        let position = point.position * scale;
        for number in position.iter().chain(&point.normal) {
            push_float(&mut bytes, *number);
        }
        bytes.extend(point.color);
        bytes.extend(point.photos.to_le_bytes());
        push_float(&mut bytes, point.sigma * scale);
    }
    bytes
}

/// Line of the header that gives the distance between points.
pub(crate) const SPACING: &str = "distance between points: ";
/// Bytes of a point.
pub(crate) const POINT_BYTES: usize = 7 * 4 + 3 + 2;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud_distance::PointCloud;

    fn surfel(x: f64, sigma: f64) -> Surfel {
        Surfel {
            position: Vector3::new(x, 0.5, 0.5),
            normal: Vector3::z(),
            color: [100, 0, 0],
            sigma,
            height_sigma: sigma,
            confirmed: false,
        }
    }

    #[test]
    fn pixels_of_one_photo_count_once_and_photos_add_up() {
        let mut cloud = Cloud::new(1.0);
        cloud.add(&[surfel(0.2, 0.1), surfel(0.4, 0.1), surfel(5.5, 0.1)]);
        let of_one = cloud.cells[&[0, 0, 0]];
        assert!((of_one.weight - 100.0).abs() < 1e-9, "{}", of_one.weight);
        cloud.add(&[surfel(0.6, 0.1)]);
        let points = cloud.points();
        // The cell that one photo alone shows is left out.
        assert_eq!(points.len(), 1);
        assert_eq!(points[0].photos, 2);
        assert!(
            (points[0].position.x - 0.45).abs() < 1e-12,
            "{}",
            points[0].position.x
        );
        // Both photos show the one pair that they are.
        assert!((points[0].sigma - 0.1).abs() < 1e-12, "{}", points[0].sigma);
        assert_eq!(points[0].color, [100, 0, 0]);
    }

    /// Three pairs of sigma^2 0.02, each in two of three photos: 0.02 / 3. One photo alone keeps its own.
    #[test]
    fn a_pair_counts_once_however_many_photos_show_it() {
        let mut cloud = Cloud::new(1.0);
        for (photos, variance) in [(1, 0.01), (2, 0.01), (3, 0.02 / 3.0_f64)] {
            cloud.add(&[surfel(0.5, 0.1)]);
            let so_far = Cloud {
                cell: cloud.cell,
                cells: cloud.cells.clone(),
            };
            let point = so_far.points()[0];
            assert_eq!(point.photos, photos);
            assert!((point.sigma - variance.sqrt()).abs() < 1e-12, "{point:?}");
        }
    }

    /// Four cells of 0.5, each in the same two photos of one pair, in one of 1.
    #[test]
    fn a_wider_cell_is_as_sure_as_its_parts() {
        let mut cloud = Cloud::new(0.5);
        for _ in 0..2 {
            let parts = [0.2, 0.7].map(|x| [0.2, 0.7].map(|y| (x, y)));
            let at = |(x, y): (f64, f64)| Surfel {
                position: Vector3::new(x, y, 0.2),
                ..surfel(0.0, 0.1)
            };
            let parts: Vec<Surfel> = parts.into_iter().flatten().map(at).collect();
            cloud.add(&parts);
        }
        assert_eq!(cloud.cells.len(), 4);
        cloud.coarsen();
        let points = cloud.points();
        assert_eq!((points.len(), points[0].photos), (1, 2));
        let off = points[0].position - Vector3::new(0.45, 0.45, 0.2);
        assert!(
            off.norm() < 1e-12 && (points[0].sigma - 0.1).abs() < 1e-12,
            "{points:?}"
        );
        assert_eq!(points[0].color, [100, 0, 0]);
    }

    #[test]
    fn a_written_cloud_is_read_in_units_of_the_world() {
        let mut cloud = Cloud::new(0.5);
        cloud.add(&[surfel(0.25, 0.125), surfel(3.25, 0.125)]);
        let points = cloud.points();
        let frame = ExportFrame {
            metres_per_unit: Some(4.0),
            up: None,
            site: None,
        };
        let bytes = ply(&points, &frame, 0.5);
        let read = PointCloud::decode(&bytes, frame.scale()).unwrap();
        assert_eq!((read.cell, &read.points), (0.5, &points));
        assert!(PointCloud::decode(&bytes[..bytes.len() - 1], 4.0).is_none());
        assert!(PointCloud::decode(b"ply\nend_header\n", 4.0).is_none());
    }

    #[test]
    fn a_cloud_of_one_pair_keeps_its_points() {
        let mut cloud = Cloud::new(1.0);
        cloud.add(&[surfel(0.2, 0.1), surfel(3.2, 0.1)]);
        assert_eq!(cloud.points().len(), 2);
    }
}
