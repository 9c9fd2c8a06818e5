//! The disparities of a pair as bytes that are kept, and as samples in both rectified pictures.

use marf_schema::depth::RowOffset;

use crate::disparities::{Class, Disparities};
use crate::raster::Raster;
use crate::search::Search;

/// Values of a disparity in a file, without that of none.
const MOST: f64 = 65_534.0;
/// Finest step of a disparity: a 64th of a pixel.
const FINEST: f64 = 64.0;
/// Steps of a standard deviation a pixel: at most one pixel fits seven bits.
const SIGMA_STEPS: f32 = 127.0;
/// The bit of an edge.
const EDGE: u8 = 128;
/// Steps of a slope a pixel: slopes from -2 to 2 fit eight bits.
const SLOPE_STEPS: f32 = 63.0;
/// Bytes of a pixel.
const BYTES: usize = 5;
/// Bytes of the rows.
const ROW_BYTES: usize = 40;

/// A pixel of a rectified picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sample {
    /// Pixels. NaN without a disparity.
    pub disparity: f32,
    pub slope_x: f32,
    pub slope_y: f32,
    /// One standard deviation, pixels.
    pub sigma: f32,
    pub edge: bool,
}

impl Sample {
    const NONE: Self = Self {
        disparity: f32::NAN,
        slope_x: 0.0,
        slope_y: 0.0,
        sigma: 0.0,
        edge: false,
    };

    pub fn is_some(&self) -> bool {
        !self.disparity.is_nan()
    }
}

/// A pair that was matched.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MatchedPair {
    pub samples: Raster<Sample>,
    /// How far the rows of the right picture were moved.
    pub rows: RowOffset,
}

/// Returns steps a pixel with which all disparities of a search fit 16 bits. The fit moves them by at most two pixels.
fn steps(search: Search) -> f64 {
    (MOST / (search.count as f64 + 4.0)).floor().min(FINEST)
}

/// Returns the disparities as bytes: five numbers of the rows, then a pixel 16 bits of disparity, 8 of standard deviation and edge, 8 of each
/// slope.
pub(crate) fn encode(found: &Disparities, rows: &RowOffset, search: Search) -> Vec<u8> {
    let steps = steps(search);
    let mut bytes = Vec::with_capacity(ROW_BYTES + found.class.values.len() * BYTES);
    for number in [
        rows.offset_px,
        rows.slope_x,
        rows.slope_y,
        f64::from(rows.matches),
        rows.rms_px,
    ] {
        bytes.extend(number.to_le_bytes());
    }
    for (i, class) in found.class.values.iter().enumerate() {
        if *class == Class::None {
            bytes.extend([0; BYTES]);
            continue;
        }
        let above = f64::from(found.disparity.values[i]) - f64::from(search.first) + 2.0;
        let value = 1 + (above * steps).round().clamp(0.0, MOST) as u16;
        bytes.extend(value.to_le_bytes());
        let sigma = (found.sigma.values[i] * SIGMA_STEPS)
            .round()
            .clamp(1.0, SIGMA_STEPS) as u8;
        bytes.push(if *class == Class::Edge {
            sigma | EDGE
        } else {
            sigma
        });
        for slope in [found.slope_x.values[i], found.slope_y.values[i]] {
            bytes.push(((slope * SLOPE_STEPS).round() as i8).cast_unsigned());
        }
    }
    bytes
}

/// Reads what [`encode`] wrote, or returns nothing for other bytes.
pub(crate) fn decode(bytes: &[u8], size: [usize; 2], search: Search) -> Option<MatchedPair> {
    let [width, height] = size;
    let (rows, bytes) = bytes.split_at_checked(ROW_BYTES)?;
    let (numbers, _) = rows.as_chunks::<8>();
    let number = |index: usize| f64::from_le_bytes(numbers[index]);
    let (pixels, rest) = bytes.as_chunks::<BYTES>();
    if !rest.is_empty() || pixels.len() != width * height {
        return None;
    }
    let steps = steps(search);
    let sample = |pixel: &[u8; BYTES]| {
        let [low, high, sigma, slope_x, slope_y] = *pixel;
        let value = u16::from_le_bytes([low, high]);
        if value == 0 {
            return Sample::NONE;
        }
        let slope = |byte: u8| f32::from(byte.cast_signed()) / SLOPE_STEPS;
        Sample {
            disparity: (f64::from(value - 1) / steps + f64::from(search.first) - 2.0) as f32,
            slope_x: slope(slope_x),
            slope_y: slope(slope_y),
            sigma: f32::from(sigma & !EDGE) / SIGMA_STEPS,
            edge: sigma & EDGE != 0,
        }
    };
    let samples = Raster {
        width,
        height,
        values: pixels.iter().map(sample).collect(),
    };
    let rows = RowOffset {
        offset_px: number(0),
        slope_x: number(1),
        slope_y: number(2),
        matches: number(3) as u32,
        rms_px: number(4),
    };
    Some(MatchedPair { samples, rows })
}

/// Neighbours whose disparities differ by at most this many pixels are one surface.
const SAME_SURFACE: f32 = 1.0;

/// Returns the samples as the right picture has them: between two neighbours of one surface they are linear, and of two
/// surfaces the nearer hides the farther.
pub(crate) fn seen_from_right(left: &Raster<Sample>) -> Raster<Sample> {
    let mut right = Raster::filled(left.width, left.height, Sample::NONE);
    for y in 0..left.height {
        let row = left.row(y);
        let mut joined = false;
        for x in 0..left.width {
            let (one, next) = (row[x], row.get(x + 1).copied().unwrap_or(Sample::NONE));
            let at = x as f32 - one.disparity;
            let rise = next.disparity - one.disparity;
            // A NaN of either is on no surface.
            if rise.abs() <= SAME_SURFACE {
                let step = 1.0 - rise;
                let mut column = at.ceil();
                while column <= at + step && step > 0.0 {
                    let share = (column - at) / step;
                    let nearer = if share < 0.5 { one } else { next };
                    let disparity = one.disparity + share * rise;
                    put(&mut right, y, column, Sample { disparity, ..nearer });
                    column += 1.0;
                }
                joined = true;
            } else {
                if one.is_some() && !joined {
                    put(&mut right, y, at.round(), one);
                }
                joined = false;
            }
        }
    }
    right
}

/// Writes a sample of the left picture to the right one, whose planes have other slopes: there x is x - d.
fn put(right: &mut Raster<Sample>, y: usize, column: f32, sample: Sample) {
    if column < 0.0 || column >= right.width as f32 {
        return;
    }
    let place = &mut right.values[y * right.width + column as usize];
    if place.is_some() && place.disparity >= sample.disparity {
        return;
    }
    let shrunk = (1.0 - sample.slope_x).max(0.25);
    *place = Sample {
        slope_x: sample.slope_x / shrunk,
        slope_y: sample.slope_y / shrunk,
        ..sample
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(disparities: &[f32]) -> Disparities {
        let raster = |value: f32| Raster::filled(disparities.len(), 1, value);
        let class = disparities
            .iter()
            .map(|d| if d.is_nan() { Class::None } else { Class::Pair });
        Disparities {
            disparity: Raster {
                values: disparities.to_vec(),
                ..raster(0.0)
            },
            slope_x: raster(-0.5),
            slope_y: raster(2.0),
            sigma: raster(0.25),
            class: Raster {
                width: disparities.len(),
                height: 1,
                values: class.collect(),
            },
        }
    }

    #[test]
    fn kept_disparities_come_back_to_a_step() {
        for (search, step) in [
            (Search { first: -8, count: 64 }, 1.0 / 64.0),
            (
                Search {
                    first: -8,
                    count: 8192,
                },
                1.0 / 7.0,
            ),
        ] {
            let disparities = [-9.4, 0.0, f32::NAN, 55.7];
            let rows = RowOffset {
                offset_px: -3.25,
                slope_x: 0.01,
                slope_y: -0.02,
                matches: 120,
                rms_px: 0.3,
            };
            let bytes = encode(&found(&disparities), &rows, search);
            let back = decode(&bytes, [4, 1], search).unwrap();
            assert_eq!(back.rows, rows);
            let back = back.samples;
            for (sample, disparity) in back.values.iter().zip(disparities) {
                assert_eq!(sample.is_some(), !disparity.is_nan());
                let error = (sample.disparity - disparity).abs();
                assert!(!sample.is_some() || error <= step / 2.0 + 1e-4, "{error}");
            }
            let sample = back.values[0];
            assert!((sample.sigma - 0.25).abs() <= 0.004, "{}", sample.sigma);
            assert!(
                (sample.slope_x + 0.5).abs() <= 0.008 && sample.slope_y == 2.0,
                "{sample:?}"
            );
            assert_eq!(decode(&bytes, [3, 1], search), None);
        }
    }

    #[test]
    fn the_right_picture_shows_the_nearer_surface_and_no_hole_in_one() {
        let search = Search { first: 0, count: 32 };
        // Two pixels of a slope, a gap, then a nearer surface.
        let left = decode(
            &encode(
                &found(&[f32::NAN, f32::NAN, 1.0, 0.5, 0.5, 4.0, 4.0]),
                &RowOffset::default(),
                search,
            ),
            [7, 1],
            search,
        )
        .unwrap()
        .samples;
        let right = seen_from_right(&left);
        let disparities: Vec<f32> = right.values.iter().map(|sample| sample.disparity).collect();
        // x = 2, 3, 4 are at 1, 2.5, 3.5, and x = 5, 6 at 1 and 2.
        assert!(disparities[0].is_nan());
        assert_eq!(disparities[1..3], [4.0, 4.0]);
        assert_eq!(disparities[3], 0.5);
        assert!(disparities[4].is_nan() && disparities[5].is_nan());
        // d = d0 + s x in the left picture is d0 + s / (1 - s) x in the right one.
        assert!(
            (right.values[1].slope_x + 1.0 / 3.0).abs() < 0.01,
            "{:?}",
            right.values[1]
        );
    }
}
