//! Conversion of an array that a label describes to an 8-bit sRGB image.

use marf_scene::{Image, Srgb};

use crate::companding::Table;
use crate::demosaic;
use crate::label::{Array, BandStorage, BayerPhase, Quantity, Sample, SampleKind};
use crate::tone::{self, WHITE_RADIANCE};

/// Longest side that is read, pixels.
const MAX_SIDE: u32 = 20_000;
/// Most pixels that are read; real products have up to 20 million.
const MAX_PIXELS: u64 = 32 << 20;

/// An array that cannot be converted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PixelError {
    /// A shape that is not a photo's, or too large.
    #[error("an array of {} bands, {} lines, {} samples is not read (1 or 3 bands, up to {MAX_SIDE} a side)", .0[0], .0[1], .0[2])]
    Shape([u32; 3]),
    /// The file ends before the array.
    #[error("the file is cut short: its label describes {needed} bytes, it has {has}")]
    Short {
        /// Bytes that the label describes.
        needed: u64,
        /// Bytes of the file.
        has: u64,
    },
    /// Samples of an unknown quantity.
    #[error("floating samples of an unknown quantity: what is white is not known")]
    UnknownQuantity,
}

/// An image made from an array.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderedArray {
    /// The image.
    pub image: Image<Srgb>,
    /// Bands: 1 or 3, a mosaic counts as 3.
    pub bands: u8,
    /// How stored values were converted to codes.
    pub notes: Vec<String>,
}

/// Returns the 8-bit sRGB image of an array.
///
/// The scaling is fixed, so that photos of one set stay comparable: spectral radiance by 0.125 W / (m2 sr nm) as white,
/// I/F by 1, counts by the largest count of their bits, then the sRGB curve; 8-bit codes are taken as they are, or
/// converted to counts by `table`. Colours are not balanced. Values that mean "missing" become black, values that mean
/// "saturated" white.
///
/// # Errors
/// See [`PixelError`]; nothing is allocated before the file has been found long enough.
pub fn render(
    array: &Array,
    mosaic: Option<BayerPhase>,
    table: Option<Table>,
    bytes: &[u8],
) -> Result<RenderedArray, PixelError> {
    let layout = Layout::new(array, bytes.len() as u64)?;
    let (scale, mut notes) = Scale::new(array, table)?;
    let (bands, lines, samples) = layout.shape;
    let mut clipped = 0_u64;
    let mut plane = |band: usize| {
        let mut values = Vec::with_capacity(lines * samples);
        for line in 0..lines {
            for sample in 0..samples {
                let (light, above) = scale.light(read(array.sample, bytes, layout.at(band, line, sample)));
                clipped += u64::from(above);
                values.push(light);
            }
        }
        values
    };
    let rgb: Vec<[f32; 3]> = match (bands, mosaic) {
        (3, _) => {
            let [red, green, blue] = [plane(0), plane(1), plane(2)];
            red.into_iter()
                .zip(green)
                .zip(blue)
                .map(|((red, green), blue)| [red, green, blue])
                .collect()
        }
        (_, None) => plane(0).into_iter().map(|light| [light; 3]).collect(),
        (_, Some(phase)) => {
            notes.push("colour mosaic (RGGB) interpolated after Malvar, He and Cutler".to_owned());
            demosaic::rggb(&plane(0), samples, lines, phase).ok_or(PixelError::Shape(array.shape))?
        }
    };
    if clipped > 0 {
        notes.push(format!("{clipped} samples above white are clipped"));
    }
    let code = |light: f32| {
        if scale.curve == Curve::AsStored {
            stored_code(light)
        } else {
            tone::code(light)
        }
    };
    Ok(RenderedArray {
        image: Image {
            width: array.shape[2],
            height: array.shape[1],
            pixels: rgb.into_iter().map(|pixel| pixel.map(code)).collect(),
        },
        bands: if bands == 3 || mosaic.is_some() { 3 } else { 1 },
        notes,
    })
}

/// Returns an 8-bit code of a value in [0, 1] without a curve.
pub fn stored_code(value: f32) -> u8 {
    (value * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

/// Strides of a checked array, bytes.
struct Layout {
    shape: (usize, usize, usize),
    offset: usize,
    strides: [usize; 3],
}

impl Layout {
    fn new(array: &Array, has: u64) -> Result<Self, PixelError> {
        let [bands, lines, samples] = array.shape;
        let sides = [lines, samples].iter().all(|side| (1..=MAX_SIDE).contains(side));
        let pixels = u64::from(lines) * u64::from(samples);
        if !sides || !matches!(bands, 1 | 3) || pixels > MAX_PIXELS {
            return Err(PixelError::Shape(array.shape));
        }
        let size = u64::from(array.sample.bytes);
        let margin = u64::from(array.prefix_bytes) + u64::from(array.suffix_bytes);
        let (bands, lines, samples) = (u64::from(bands), u64::from(lines), u64::from(samples));
        // A record is a line of one band, or of all bands where pixels are interleaved.
        let across = if array.order == BandStorage::PixelInterleaved {
            bands
        } else {
            1
        };
        let record = samples * across * size + margin;
        let strides = match array.order {
            BandStorage::BandSequential => [lines * record, record, size],
            BandStorage::LineInterleaved => [record, bands * record, size],
            BandStorage::PixelInterleaved => [size, record, bands * size],
        };
        let needed = array
            .offset
            .saturating_add((lines * bands / across).saturating_mul(record));
        if needed > has {
            return Err(PixelError::Short { needed, has });
        }
        Ok(Self {
            shape: (bands as usize, lines as usize, samples as usize),
            offset: (array.offset + u64::from(array.prefix_bytes)) as usize,
            strides: strides.map(|stride| stride as usize),
        })
    }

    fn at(&self, band: usize, line: usize, sample: usize) -> usize {
        self.offset + band * self.strides[0] + line * self.strides[1] + sample * self.strides[2]
    }
}

/// Reads one stored value; the layout has been checked to lie in the file.
fn read(sample: Sample, bytes: &[u8], at: usize) -> f64 {
    let size = sample.bytes as usize;
    let Some(stored) = bytes.get(at..at + size) else {
        return f64::NAN;
    };
    let mut word = [0_u8; 8];
    for (index, byte) in stored.iter().enumerate() {
        // To big-endian, right-aligned.
        let place = if sample.big_endian {
            8 - size + index
        } else {
            7 - index
        };
        word[place] = *byte;
    }
    let bits = u64::from_be_bytes(word);
    let shift = 64 - 8 * sample.bytes;
    match (sample.kind, sample.bytes) {
        (SampleKind::Unsigned, _) => bits as f64,
        (SampleKind::Signed, _) => ((bits << shift) as i64 >> shift) as f64,
        (SampleKind::Float, 4) => f64::from(f32::from_bits(bits as u32)),
        (SampleKind::Float, _) => f64::from_bits(bits),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Curve {
    Srgb,
    AsStored,
}

/// Conversion of stored values to light in [0, 1].
struct Scale<'a> {
    factor: f64,
    offset: f64,
    missing: &'a [f64],
    saturated: &'a [f64],
    table: Option<Table>,
    curve: Curve,
}

impl<'a> Scale<'a> {
    fn new(array: &'a Array, table: Option<Table>) -> Result<(Self, Vec<String>), PixelError> {
        let (scaling, sample) = (array.scaling, array.sample);
        let with = |factor: f64, offset: f64, curve, note: String| {
            let scale = Scale {
                factor,
                offset,
                missing: &array.missing,
                saturated: &array.saturated,
                table: None,
                curve,
            };
            Ok((scale, vec![note]))
        };
        if let Some(codes) = array
            .companded_by
            .as_deref()
            .filter(|_| sample.kind != SampleKind::Float)
        {
            let (factor, curve, note) = match table {
                Some(table) => (
                    1.0 / f64::from(table.white),
                    Curve::Srgb,
                    format!(
                        "8-bit codes made counts by {codes}, counts to sRGB, white at {}",
                        table.white
                    ),
                ),
                None => (
                    1.0 / 255.0,
                    Curve::AsStored,
                    format!("8-bit codes of {codes}, which is not known: as stored"),
                ),
            };
            let (scale, notes) = with(factor, 0.0, curve, note)?;
            return Ok((Scale { table, ..scale }, notes));
        }
        let (scale, offset) = scaling.unwrap_or((1.0, 0.0));
        let physical = scaling.is_some() || sample.kind == SampleKind::Float;
        match array.quantity {
            Quantity::Radiance if physical => {
                let note = format!("radiance to sRGB, white at {WHITE_RADIANCE} W/m2/sr/nm");
                with(scale / WHITE_RADIANCE, offset / WHITE_RADIANCE, Curve::Srgb, note)
            }
            Quantity::Reflectance if physical => {
                with(scale, offset, Curve::Srgb, "I/F to sRGB, white at 1".to_owned())
            }
            _ if sample.kind == SampleKind::Float => Err(PixelError::UnknownQuantity),
            _ if sample.bytes == 1 && sample.kind == SampleKind::Unsigned => with(
                1.0 / 255.0,
                0.0,
                Curve::AsStored,
                "8-bit codes as stored".to_owned(),
            ),
            _ => {
                let whole = 8 * sample.bytes - u32::from(sample.kind == SampleKind::Signed);
                // A mask of fewer bits describes the detector, not values that were scaled since.
                let bits = array
                    .bits
                    .filter(|bits| scaling.is_none() && *bits <= whole)
                    .unwrap_or(whole);
                let white = (1_u64 << bits.min(63)) as f64 - 1.0;
                with(
                    1.0 / white,
                    0.0,
                    Curve::Srgb,
                    format!("counts to sRGB, white at {white}"),
                )
            }
        }
    }

    /// Returns the light, and whether it was above white.
    fn light(&self, stored: f64) -> (f32, bool) {
        if stored.is_nan() || self.missing.contains(&stored) {
            return (0.0, false);
        }
        if self.saturated.contains(&stored) {
            return (1.0, false);
        }
        let value = match self.table {
            Some(table) => f64::from(table.counts[stored.clamp(0.0, 255.0) as usize]),
            None => stored,
        };
        let light = value * self.factor + self.offset;
        (light.clamp(0.0, 1.0) as f32, light > 1.0)
    }
}

#[cfg(test)]
mod tests;
