//! The maps as pictures.

use marf_scene::picture::png16::{self, Quantity};
use marf_schema::changes::{Change, ChangesReport};

use super::cells::{Values, colour};
use super::compare::Comparison;
use super::noise::{Ground, NINETY};
use crate::SurfaceError;
use crate::ply::to_byte;

/// Colours of changes on the map, in which the ground is gray.
pub(super) const INKS: [(Change, [u8; 3]); 4] = [
    (Change::Higher, [214, 69, 65]),
    (Change::Lower, [52, 111, 201]),
    (Change::Colour, [230, 170, 30]),
    (Change::Undecided, [150, 110, 190]),
];
/// Share of the ink over the gray of the ground.
const INK: f64 = 0.7;
/// Ground that one time alone shows is so much darker.
const ALONE: f64 = 0.35;

/// Returns all maps with their names.
pub(super) fn pictures(
    map: &Comparison,
    report: &ChangesReport,
) -> Result<Vec<(&'static str, Vec<u8>)>, SurfaceError> {
    Ok(vec![
        ("map", changes(map)?),
        ("before", photo(map, &map.before)?),
        ("after", photo(map, &map.after)?),
        ("height", heights(map, report)?),
        ("height-interval", interval(map)?),
    ])
}

/// Draws the changes in colours over the ground in gray. A cell is dark if only one time shows it,
/// transparent if none does.
fn changes(map: &Comparison) -> Result<Vec<u8>, SurfaceError> {
    let ground = map.after.cells.iter().zip(&map.before.cells);
    let pixel = |(place, (after, before)): (usize, (&Option<_>, &Option<_>))| {
        let Some(cell) = after.or(*before) else {
            return [0; 4];
        };
        let gray = srgb(brightness(&cell));
        let gray = if map.cells[place].is_some() {
            [gray; 3]
        } else {
            [gray * ALONE; 3]
        };
        let ink = INKS
            .iter()
            .find(|(change, _)| map.patches.of_cell[place] == Some(*change));
        let shown = ink.map_or(gray, |(_, ink)| {
            [0, 1, 2].map(|channel| gray[channel] * (1.0 - INK) + f64::from(ink[channel]) / 255.0 * INK)
        });
        let [r, g, b] = shown.map(|share| to_byte(share as f32));
        [r, g, b, 255]
    };
    let pixels: Vec<[u8; 4]> = ground.enumerate().map(pixel).collect();
    let words = "red: higher; blue: lower; yellow: another colour; violet: brighter or darker, light or ground; dark: one time alone";
    rgba(map, &pixels, words)
}

fn photo(map: &Comparison, ground: &Ground) -> Result<Vec<u8>, SurfaceError> {
    let pixel = |cell: &Option<super::noise::Cell>| match cell {
        Some(cell) => {
            let [r, g, b] = colour(cell.mean).map(|light| to_byte(srgb(light) as f32));
            [r, g, b, 255]
        }
        None => [0; 4],
    };
    let pixels: Vec<[u8; 4]> = ground.cells.iter().map(pixel).collect();
    rgba(map, &pixels, "mean over the trainings")
}

/// Writes the change of the height.
fn heights(map: &Comparison, report: &ChangesReport) -> Result<Vec<u8>, SurfaceError> {
    let differences = map.cells.iter().flatten().map(|cell| cell.difference[0]);
    let (low, high) = differences.fold((0.0_f64, 0.0_f64), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    let step = ((high - low) / (png16::MOST - 1.0)).max(1e-6);
    let value = |cell: &Option<super::compare::CellDifference>| {
        cell.map_or(0, |cell| 1 + ((cell.difference[0] - low) / step).round() as u16)
    };
    let values: Vec<u16> = map.cells.iter().map(value).collect();
    let text = [
        (
            "marf:height-change",
            "metres, later less earlier = lowest + (value - 1) * interval; 0: not known".to_owned(),
        ),
        ("marf:height-lowest", low.to_string()),
        ("marf:height-interval", step.to_string()),
        ("marf:resolution", format!("{} metres a pixel", report.cell_m)),
    ];
    Ok(png16::gray(map.extent.columns, map.extent.rows, &values, &text)?)
}

fn interval(map: &Comparison) -> Result<Vec<u8>, SurfaceError> {
    let values = map
        .cells
        .iter()
        .map(|cell| cell.map_or(0.0, |cell| (cell.sigma[0] * NINETY) as f32));
    let values: Vec<f32> = values.collect();
    let quantity = Quantity {
        name: "height-interval",
        unit: "m",
        kind: "half width of the interval that holds 90 % of the changes of height where nothing changed",
    };
    Ok(png16::quantity(
        map.extent.columns,
        map.extent.rows,
        &values,
        1.0,
        &quantity,
    )?)
}

fn rgba(map: &Comparison, pixels: &[[u8; 4]], words: &str) -> Result<Vec<u8>, SurfaceError> {
    let text = [
        ("marf:picture", words.to_owned()),
        ("marf:resolution", format!("{} metres a pixel", map.cell_m)),
    ];
    Ok(png16::rgba(map.extent.columns, map.extent.rows, pixels, &text)?)
}

fn brightness(cell: &super::noise::Cell) -> f64 {
    let [_, brightness, ..]: Values = cell.mean;
    libm::exp(brightness)
}

/// Linear light to sRGB (IEC 61966-2-1).
fn srgb(light: f64) -> f64 {
    if light <= 0.003_130_8 {
        return 12.92 * light;
    }
    1.055 * libm::pow(light, 1.0 / 2.4) - 0.055
}
