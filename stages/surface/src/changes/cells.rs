//! The maps of one surface as cells of the grid of maps.

use std::io::Cursor;

use image::{ImageFormat, ImageReader};
use marf_schema::output::SURFACE_MAPS;
use marf_schema::surface::SurfaceReport;
use marf_stage::{Ctx, Outputs, StageError};

/// Least linear light of a channel: below it 8 bits are noise.
const DARKEST: f64 = 0.002;

/// Known cells among the nine around a place from which on the place is known.
const LEAST_KNOWN: u32 = 3;

/// Numbers of a cell: height (metres), ln of the brightness, ln of red over green, ln of blue over green.
pub(super) type Values = [f64; 4];

/// Cells that a map has, counted from the origin to the right and up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Extent {
    pub left: i64,
    pub top: i64,
    pub columns: u32,
    pub rows: u32,
}

impl Extent {
    /// Returns the extent that has all of both.
    pub fn with(self, other: Self) -> Self {
        let right = (self.left + i64::from(self.columns)).max(other.left + i64::from(other.columns));
        let bottom = (self.top - i64::from(self.rows)).min(other.top - i64::from(other.rows));
        let (left, top) = (self.left.min(other.left), self.top.max(other.top));
        Self {
            left,
            top,
            columns: (right - left) as u32,
            rows: (top - bottom) as u32,
        }
    }

    pub fn cells(&self) -> usize {
        self.columns as usize * self.rows as usize
    }

    /// Returns the place of a cell of another extent in this one. `None` outside.
    pub fn place(&self, other: &Self, column: u32, row: u32) -> Option<usize> {
        let across = u32::try_from(other.left - self.left + i64::from(column)).ok()?;
        let down = u32::try_from(self.top - other.top + i64::from(row)).ok()?;
        let is_inside = across < self.columns && down < self.rows;
        is_inside.then(|| down as usize * self.columns as usize + across as usize)
    }

    /// Returns the part of it that has all of some places, and some cells around them. `None` without a
    /// place.
    pub fn around(&self, places: impl Iterator<Item = usize>, margin: i64) -> Option<Self> {
        let columns = self.columns as usize;
        let corners = places.map(|place| {
            let (column, row) = ((place % columns) as i64, (place / columns) as i64);
            [column, column, row, row]
        });
        let [first, last, top, bottom] =
            corners.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].max(b[3])])?;
        let (first, top) = ((first - margin).max(0), (top - margin).max(0));
        let last = (last + margin).min(i64::from(self.columns) - 1);
        let bottom = (bottom + margin).min(i64::from(self.rows) - 1);
        Some(Self {
            left: self.left + first,
            top: self.top - top,
            columns: (last - first + 1) as u32,
            rows: (bottom - top + 1) as u32,
        })
    }
}

/// The maps of one surface.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    pub extent: Extent,
    pub cell_m: f64,
    /// `[rows * columns]`. `None` without a surface.
    pub values: Vec<Option<Values>>,
    /// `[rows * columns]`: how far the views of the field differ there, metres. 0 if unknown.
    pub spread_m: Vec<f64>,
}

impl Grid {
    /// Reads height map and orthophoto of a surface.
    ///
    /// # Errors
    /// A surface without a map, with the reason. Damaged maps.
    pub fn read(ctx: &Ctx<'_>, outputs: &Outputs) -> Result<Self, StageError> {
        let report: SurfaceReport = super::outputs::document(ctx, outputs)?;
        let Some(map) = report.map else {
            let why = report.refused.get(SURFACE_MAPS).cloned().unwrap_or_default();
            return Err(StageError::new(format!("a surface has no map: {why}")));
        };
        let heights = picture(ctx, outputs, "height")?.into_luma16();
        let colours = picture(ctx, outputs, "orthophoto")?.into_rgba8();
        let spreads = picture(ctx, outputs, "spread")?.into_luma16();
        let size = (map.columns, map.rows);
        let dimensions = [heights.dimensions(), colours.dimensions(), spreads.dimensions()];
        if dimensions != [size; 3] {
            return Err(StageError::new(
                "maps of a surface are not of the size that it states",
            ));
        }
        let first = map
            .first_m
            .map(|metres| (metres / map.pixel_m - 0.5).round() as i64);
        let pixels = heights.pixels().zip(colours.pixels());
        let values = pixels.map(|(height, colour)| {
            let steps = height.0[0].checked_sub(1)?;
            let [r, g, b, _] = colour.0;
            Some(values(
                map.lowest_m + f64::from(steps) * map.interval_m,
                [r, g, b],
            ))
        });
        Ok(Self::smoothed(
            Extent {
                left: first[0],
                top: first[1],
                columns: map.columns,
                rows: map.rows,
            },
            map.pixel_m,
            &values.collect::<Vec<_>>(),
            spreads
                .pixels()
                .map(|steps| f64::from(steps.0[0].saturating_sub(1)) * 0.001)
                .collect(),
        ))
    }

    /// Averages numbers over each cell and those around it, where at least three are known: finer structure
    /// of a field is noise.
    fn smoothed(extent: Extent, cell_m: f64, values: &[Option<Values>], spread_m: Vec<f64>) -> Self {
        let mean = |place: usize| {
            let (mut count, mut sum) = (0_u32, [0.0; 4]);
            for known in around(&extent, place, 1).filter_map(|near| values[near]) {
                count += 1;
                (0..4).for_each(|quantity| sum[quantity] += known[quantity]);
            }
            (count >= LEAST_KNOWN).then(|| sum.map(|sum| sum / f64::from(count)))
        };
        Self {
            values: (0..values.len()).map(mean).collect(),
            spread_m,
            extent,
            cell_m,
        }
    }
}

/// Returns the places of the cells around one, itself among them, up to `reach` cells away along each axis.
pub(super) fn around(extent: &Extent, place: usize, reach: i64) -> impl Iterator<Item = usize> + use<> {
    let (columns, rows) = (i64::from(extent.columns), i64::from(extent.rows));
    let (column, row) = (place as i64 % columns, place as i64 / columns);
    let down = (row - reach).max(0)..(row + reach + 1).min(rows);
    down.flat_map(move |row| {
        let across = (column - reach).max(0)..(column + reach + 1).min(columns);
        across.map(move |column| (row * columns + column) as usize)
    })
}

/// Returns the numbers of a cell with a height (metres) and a colour (sRGB).
pub(super) fn values(height_m: f64, srgb: [u8; 3]) -> Values {
    let [r, g, b] = srgb.map(linear);
    // Rec. 709.
    let brightness = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    [
        height_m,
        libm::log(brightness),
        libm::log(r / g),
        libm::log(b / g),
    ]
}

/// Returns the colour (linear RGB) of numbers, with the brightness as that of green: a picture for people.
pub(super) fn colour([_, brightness, red, blue]: Values) -> [f64; 3] {
    let (r, b) = (libm::exp(red), libm::exp(blue));
    let g = libm::exp(brightness) / (0.2126 * r + 0.7152 + 0.0722 * b);
    [r * g, g, b * g]
}

/// sRGB to linear light (IEC 61966-2-1).
fn linear(value: u8) -> f64 {
    let value = f64::from(value) / 255.0;
    let light = if value <= 0.040_45 {
        value / 12.92
    } else {
        libm::pow((value + 0.055) / 1.055, 2.4)
    };
    light.max(DARKEST)
}

fn picture(ctx: &Ctx<'_>, outputs: &Outputs, name: &str) -> Result<image::DynamicImage, StageError> {
    let output = format!("{SURFACE_MAPS}{name}.png");
    let digest = outputs
        .get(&output)
        .ok_or_else(|| StageError::new(format!("a surface has no `{output}`")))?;
    let bytes = ctx.get(digest)?;
    let read = ImageReader::with_format(Cursor::new(&*bytes), ImageFormat::Png).decode();
    read.map_err(|error| StageError::new(format!("`{output}`: {error}")))
}
