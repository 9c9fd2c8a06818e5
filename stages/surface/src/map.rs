//! A mesh from above: height map and orthophoto with world files.

use marf_scene::picture::png16::{self, MOST};
use marf_schema::surface::MapReport;
use nalgebra::{Vector2, Vector3};

use crate::SurfaceError;
use crate::frame::ExportFrame;
use crate::geotiff;
use crate::mesh::Mesh;
use crate::ply::to_byte;
use crate::triangle::covered_pixels;

/// Most pixels of a map.
const MOST_PIXELS: f64 = 64e6;
/// Least distance from one height to the next, metres: finer than any photo.
const FINEST_M: f64 = 0.001;

/// A surface as seen from straight above.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceMap {
    /// Sizes, scales and axes.
    pub report: MapReport,
    /// `[rows * columns]`, from the top: height and colour of the highest surface. `None` without a surface.
    cells: Vec<Option<MapCell>>,
    spread: SpreadWords,
}

/// Surface in a pixel of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapCell {
    /// Along up from the origin of the map's frame, metres.
    pub height_m: f64,
    /// sRGB in [0, 1].
    pub color: [f32; 3],
    /// How unsure the height is, metres. Negative if that is not known.
    pub spread_m: f64,
}

/// What the spread of a map is, in words.
pub type SpreadWords = &'static str;

/// The spread of a mesh.
const OF_VIEWS: SpreadWords =
    "root mean square of the distances between the views' surfaces and this one, along its normal";

/// The pixels of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapGrid {
    /// Width of a pixel, metres.
    pub pixel_m: f64,
    /// Pixels from the origin to the first column, to the right, and to the last row, to the top.
    pub first: Vector2<f64>,
    /// Columns.
    pub columns: u32,
    /// Rows.
    pub rows: u32,
}

impl SurfaceMap {
    /// Draws a mesh from above: at the centre of each pixel the highest triangle, linear between its vertices.
    ///
    /// `pixel_m`: width of a pixel, metres. Pixels are on a grid through the origin of the site (of the world
    /// without one), so that maps of one site fit each other.
    ///
    /// # Errors
    /// [`SurfaceError::Refused`] for a scene without scale or up, a mesh without triangles and a map of more than 64 million pixels.
    pub fn draw(mesh: &Mesh, frame: &ExportFrame, pixel_m: f64) -> Result<Self, SurfaceError> {
        let (axes, metres) = frame.metric_map("the height map")?;
        let refused = |why: String| SurfaceError::Refused {
            what: "the height map",
            why,
        };
        let flat: Vec<Vector3<f64>> = mesh
            .vertices
            .iter()
            .map(|vertex| axes.place(&(vertex.position * metres + frame.origin_m())))
            .collect();
        let far = Vector2::repeat(f64::INFINITY);
        let (low, high) = flat.iter().fold((far, -far), |(low, high), at| {
            (low.inf(&at.xy()), high.sup(&at.xy()))
        });
        if mesh.triangles.is_empty() {
            return Err(refused("the mesh is empty".to_owned()));
        }
        let first = (low / pixel_m).map(f64::floor);
        let size = (high / pixel_m).map(f64::floor) - first + Vector2::repeat(1.0);
        if size.x * size.y > MOST_PIXELS {
            return Err(refused(format!(
                "{} x {} pixels of {pixel_m} m are too many: widen `map_cell`",
                size.x, size.y
            )));
        }
        let (columns, rows) = (size.x as u32, size.y as u32);
        let mut cells = vec![None; columns as usize * rows as usize];
        for triangle in &mesh.triangles {
            let corners = triangle.map(|vertex| flat[vertex as usize]);
            for pixel in covered_pixels(&corners, pixel_m, &first, columns, rows) {
                let cell = blend(mesh, triangle, &corners, pixel.shares, metres);
                let place = &mut cells[pixel.row as usize * columns as usize + pixel.column as usize];
                if place.is_none_or(|known: MapCell| known.height_m < cell.height_m) {
                    *place = Some(cell);
                }
            }
        }
        let grid = MapGrid {
            pixel_m,
            first,
            columns,
            rows,
        };
        Self::from_cells(frame, grid, cells, OF_VIEWS)
    }

    /// Takes the pixels of a map, `[rows * columns]`, from the top.
    ///
    /// # Errors
    /// [`SurfaceError::Refused`] for a scene without scale or up, and if no pixel has a surface.
    pub fn from_cells(
        frame: &ExportFrame,
        grid: MapGrid,
        cells: Vec<Option<MapCell>>,
        spread: SpreadWords,
    ) -> Result<Self, SurfaceError> {
        let (axes, _) = frame.metric_map("the height map")?;
        let MapGrid {
            pixel_m,
            first,
            columns,
            rows,
        } = grid;
        let heights = || cells.iter().flatten().map(|cell| cell.height_m);
        let lowest_m = heights().fold(f64::INFINITY, f64::min);
        let highest_m = heights().fold(f64::NEG_INFINITY, f64::max);
        let covered = heights().count();
        if covered == 0 {
            return Err(SurfaceError::Refused {
                what: "the height map",
                why: format!("no surface covers the centre of a pixel of {pixel_m} m"),
            });
        }
        let report = MapReport {
            columns,
            rows,
            pixel_m,
            lowest_m,
            interval_m: interval(highest_m - lowest_m),
            first_m: [
                (first.x + 0.5) * pixel_m,
                (first.y + f64::from(rows) - 0.5) * pixel_m,
            ],
            axes: [axes.right, axes.top, axes.up].map(Into::into),
            origin: frame.origin_words(),
            covered_share: covered as f64 / cells.len() as f64,
        };
        Ok(Self {
            report,
            cells,
            spread,
        })
    }

    /// Returns the heights as PNG of 16 bits: height = lowest + (value - 1) · interval, 0 where there is no surface.
    ///
    /// # Errors
    /// [`SurfaceError::Png`].
    pub fn height_png(&self) -> Result<Vec<u8>, SurfaceError> {
        let MapReport {
            lowest_m, interval_m, ..
        } = self.report;
        let value = |cell: &Option<MapCell>| match cell {
            Some(cell) => 1 + ((cell.height_m - lowest_m) / interval_m).round().clamp(0.0, MOST) as u16,
            None => 0,
        };
        let values: Vec<u16> = self.cells.iter().map(value).collect();
        let text = [
            (
                "marf:height",
                "metres along up = lowest + (value - 1) * interval; 0: no surface".to_owned(),
            ),
            ("marf:height-lowest", lowest_m.to_string()),
            ("marf:height-interval", interval_m.to_string()),
            (
                "marf:resolution",
                format!("{} metres a pixel", self.report.pixel_m),
            ),
            ("marf:axes", self.axes_text()),
        ];
        self.gray_png(&values, &text)
    }

    fn gray_png(&self, values: &[u16], text: &[(&str, String)]) -> Result<Vec<u8>, SurfaceError> {
        Ok(png16::gray(self.report.columns, self.report.rows, values, text)?)
    }

    /// Returns how unsure each pixel is as PNG of 16 bits: millimetres + 1, 0 where that is not known.
    ///
    /// # Errors
    /// [`SurfaceError::Png`].
    pub fn spread_png(&self) -> Result<Vec<u8>, SurfaceError> {
        let value = |cell: &Option<MapCell>| match cell {
            Some(cell) if cell.spread_m >= 0.0 => 1 + (cell.spread_m * 1000.0).round().min(MOST) as u16,
            _ => 0,
        };
        let values: Vec<u16> = self.cells.iter().map(value).collect();
        let words = format!("millimetres + 1: {}; 0: not known", self.spread);
        let text = [
            ("marf:spread", words),
            (
                "marf:resolution",
                format!("{} metres a pixel", self.report.pixel_m),
            ),
        ];
        self.gray_png(&values, &text)
    }

    /// Returns the colours as PNG, transparent where there is no surface.
    ///
    /// # Errors
    /// [`SurfaceError::Png`].
    pub fn photo_png(&self) -> Result<Vec<u8>, SurfaceError> {
        let text = [
            (
                "marf:resolution",
                format!("{} metres a pixel", self.report.pixel_m),
            ),
            ("marf:axes", self.axes_text()),
        ];
        Ok(png16::rgba(
            self.report.columns,
            self.report.rows,
            &self.pixels(),
            &text,
        )?)
    }

    /// Returns the colours of all pixels, transparent where there is no surface.
    fn pixels(&self) -> Vec<[u8; 4]> {
        let pixel = |cell: &Option<MapCell>| match cell {
            Some(cell) => {
                let [r, g, b] = cell.color.map(to_byte);
                [r, g, b, 255]
            }
            None => [0; 4],
        };
        self.cells.iter().map(pixel).collect()
    }

    /// Returns the heights as GeoTIFF of 32-bit floats, metres. NaN where there is no surface.
    ///
    /// # Errors
    /// [`SurfaceError::Tiff`].
    pub fn height_tiff(&self) -> Result<Vec<u8>, SurfaceError> {
        let height = |cell: &MapCell| Some(cell.height_m);
        self.quantity_tiff(height, "height along up from the origin")
    }

    /// Returns how unsure each pixel is as GeoTIFF of 32-bit floats, metres. NaN where that is not known.
    ///
    /// # Errors
    /// [`SurfaceError::Tiff`].
    pub fn spread_tiff(&self) -> Result<Vec<u8>, SurfaceError> {
        let spread = |cell: &MapCell| (cell.spread_m >= 0.0).then_some(cell.spread_m);
        self.quantity_tiff(spread, self.spread)
    }

    fn quantity_tiff(
        &self,
        value: impl Fn(&MapCell) -> Option<f64>,
        words: &str,
    ) -> Result<Vec<u8>, SurfaceError> {
        let values = self.cells.iter().map(|cell| cell.as_ref().and_then(&value));
        let values: Vec<f32> = values
            .map(|value| value.map_or(f32::NAN, |value| value as f32))
            .collect();
        Ok(geotiff::quantity(&self.report, &values, words, "m")?)
    }

    /// Returns the colours as GeoTIFF, transparent where there is no surface.
    ///
    /// # Errors
    /// [`SurfaceError::Tiff`].
    pub fn photo_tiff(&self) -> Result<Vec<u8>, SurfaceError> {
        Ok(geotiff::colors(&self.report, &self.pixels())?)
    }

    /// Returns the world file of all maps (ESRI): six lines, pixel to metres on the map. The fifth and sixth
    /// are the centre of the first pixel.
    pub fn world_file(&self) -> String {
        let MapReport { pixel_m, first_m, .. } = self.report;
        format!("{pixel_m}\n0\n0\n{}\n{}\n{}\n", -pixel_m, first_m[0], first_m[1])
    }

    fn axes_text(&self) -> String {
        let [right, top, up] = self.report.axes;
        let origin = &self.report.origin;
        format!("right {right:?}, top {top:?}, up {up:?}; metres from the origin of {origin}")
    }
}

fn blend(
    mesh: &Mesh,
    triangle: &[u32; 3],
    corners: &[Vector3<f64>; 3],
    shares: [f64; 3],
    metres: f64,
) -> MapCell {
    let vertices = triangle.map(|vertex| mesh.vertices[vertex as usize]);
    let mean =
        |value: &dyn Fn(usize) -> f64| (0..3).map(|corner| shares[corner] * value(corner)).sum::<f64>();
    let is_known = vertices.iter().all(|vertex| vertex.spread >= 0.0);
    MapCell {
        height_m: mean(&|corner| corners[corner].z),
        color: [0, 1, 2].map(|channel| mean(&|corner| f64::from(vertices[corner].color[channel])) as f32),
        spread_m: if is_known {
            mean(&|corner| f64::from(vertices[corner].spread)) * metres
        } else {
            -1.0
        },
    }
}

/// Returns the distance between heights: 1 mm, or as many times 1, 2 or 5 of a power of ten as the range
/// requires.
fn interval(range_m: f64) -> f64 {
    let mut steps =
        (0..12).flat_map(|power| [1.0, 2.0, 5.0].map(|step| step * FINEST_M * 10_f64.powi(power)));
    steps.find(|step| range_m / step < MOST).unwrap_or(range_m / MOST)
}

#[cfg(test)]
mod tests;
