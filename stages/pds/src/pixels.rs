//! Conversion of an array that a label describes to an 8-bit sRGB image.

use marf_scene::{Image, Srgb, TooLarge};

use crate::companding::Table;
use crate::demosaic;
use crate::label::{Array, BandStorage, BayerPhase, Quantity, Sample, SampleKind};
use crate::sun;
use crate::tone::{self, WHITE_RADIANCE};

/// Bytes in memory of a pixel of the image, and of one that is interpolated from a mosaic.
const PIXEL_BYTES: u64 = 3;
const MOSAIC_BYTES: u64 = 19;

/// An array that cannot be converted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PixelError {
    /// A shape that is not a photo's.
    #[error("an array of {} bands, {} lines, {} samples is not read: a photo has 1 or 3 bands", .0[0], .0[1], .0[2])]
    Shape([u32; 3]),
    /// More memory than the limit.
    #[error(transparent)]
    TooLarge(#[from] TooLarge),
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

/// Returns the 8-bit sRGB image of an array, as it is displayed.
///
/// The scaling is fixed, so that photos of one set stay comparable. White is 0.125 W / (m2 sr nm) for spectral
/// radiance. I/F is turned into radiance by the light of the sun, so that both come out alike. White is the largest count of their bits for counts, followed by the sRGB curve. 8-bit codes are
/// taken as they are, or converted to counts by `table`. Colours are not balanced. A pixel becomes black where every
/// band holds a value that means "missing": in one band alone, such a value may be light. Values that mean
/// "saturated" become white.
///
/// # Errors
/// See [`PixelError`]. Memory is allocated only after the length of the file and the limit have been checked.
pub fn render(
    array: &Array,
    mosaic: Option<BayerPhase>,
    table: Option<Table>,
    bytes: &[u8],
    limit_bytes: u64,
) -> Result<RenderedArray, PixelError> {
    if !matches!(array.shape[0], 1 | 3) {
        return Err(PixelError::Shape(array.shape));
    }
    let stored = Stored::new(array, bytes)?;
    let pixel_bytes = if mosaic.is_some() {
        MOSAIC_BYTES
    } else {
        PIXEL_BYTES
    };
    TooLarge::check(array.shape[2], array.shape[1], pixel_bytes, limit_bytes)?;
    let (scale, mut notes) = Scale::new(array, table)?;
    let (bands, lines, samples) = stored.layout.shape;
    let mut light = Light {
        scale: &scale,
        clipped: 0,
        most: 0.0,
    };
    let places = (0..lines).flat_map(|line| (0..samples).map(move |sample| (line, sample)));
    let code = |light: f32| scale.code(light);
    let pixels: Vec<[u8; 3]> = match (bands, mosaic) {
        (3, _) => places
            .map(|(line, sample)| light.pixel([0, 1, 2].map(|band| stored.value(band, line, sample))))
            .map(|pixel| pixel.map(code))
            .collect(),
        (_, None) => places
            .map(|(line, sample)| light.pixel([stored.value(0, line, sample)]))
            .map(|[gray]| [code(gray); 3])
            .collect(),
        (_, Some(phase)) => {
            let plane: Vec<f32> = places
                .map(|(line, sample)| light.pixel([stored.value(0, line, sample)])[0])
                .collect();
            notes.push("colour mosaic (RGGB) interpolated after Malvar, He and Cutler".to_owned());
            let rgb = demosaic::rggb(&plane, samples, lines, phase).ok_or(PixelError::Shape(array.shape))?;
            rgb.into_iter().map(|pixel| pixel.map(code)).collect()
        }
    };
    notes.extend(light.notes());
    let mut image = Image {
        width: array.shape[2],
        height: array.shape[1],
        pixels,
    };
    notes.extend(display(array, &mut image));
    Ok(RenderedArray {
        image,
        bands: if bands == 3 || mosaic.is_some() { 3 } else { 1 },
        notes,
    })
}

/// Turns stored pixels as they are displayed. Returns a note if they were turned.
fn display(array: &Array, image: &mut Image<Srgb>) -> Option<String> {
    let mut turned = Vec::new();
    if array.upside_down {
        image.pixels.reverse();
        turned.push("from bottom to top");
    }
    // Reversing all pixels turns lines and samples.
    if array.upside_down != array.mirrored {
        let width = image.width.max(1) as usize;
        image.pixels.chunks_exact_mut(width).for_each(<[_]>::reverse);
    }
    if array.mirrored {
        turned.push("from right to left");
    }
    (!turned.is_empty()).then(|| format!("displayed {}, by its label", turned.join(" and ")))
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
        if bands == 0 || lines == 0 || samples == 0 {
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
        let needed = array
            .offset
            .saturating_add((lines * bands / across).saturating_mul(record));
        if needed > has {
            return Err(PixelError::Short { needed, has });
        }
        let strides = match array.order {
            BandStorage::BandSequential => [lines * record, record, size],
            BandStorage::LineInterleaved => [record, bands * record, size],
            BandStorage::PixelInterleaved => [size, record, bands * size],
        };
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

/// The stored values of an array.
pub struct Stored<'a> {
    sample: Sample,
    layout: Layout,
    bytes: &'a [u8],
}

impl<'a> Stored<'a> {
    /// Checks that the file holds the whole array.
    pub fn new(array: &Array, bytes: &'a [u8]) -> Result<Self, PixelError> {
        Ok(Self {
            sample: array.sample,
            layout: Layout::new(array, bytes.len() as u64)?,
            bytes,
        })
    }

    pub fn value(&self, band: usize, line: usize, sample: usize) -> f64 {
        read(self.sample, self.bytes, self.layout.at(band, line, sample))
    }
}

/// Converts pixels to light.
struct Light<'a> {
    scale: &'a Scale<'a>,
    /// Samples above white.
    clipped: u64,
    /// Most light of a sample.
    most: f64,
}

impl Light<'_> {
    /// Returns the light of the bands of a pixel, black where all of them are missing.
    fn pixel<const N: usize>(&mut self, stored: [f64; N]) -> [f32; N] {
        if stored.iter().all(|value| self.scale.is_missing(*value)) {
            return [0.0; N];
        }
        std::array::from_fn(|band| {
            let value = stored[band];
            let light = self.scale.light(band, value);
            self.clipped += u64::from(light > 1.0 && !self.scale.is_saturated(value));
            self.most = self.most.max(light);
            light.clamp(0.0, 1.0) as f32
        })
    }

    /// Returns notes on the tones.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.clipped > 0 {
            notes.push(format!("{} samples above white are clipped", self.clipped));
        }
        if let White::Doubtful(white) = self.scale.white
            && self.most < DARK
        {
            let most = (self.most * white).round();
            notes.push(format!(
                "doubtful tones: the largest count is {most} and the label does not say how many bits are used. White is {white}"
            ));
        }
        notes
    }
}

/// Reads one stored value. The layout has been checked to fit the file.
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

/// Most light of counts that may have fewer bits than their type: of 12 bits in 16, it is below 1/16.
const DARK: f64 = 1.0 / 15.0;

/// Whether it is known which value is white.
#[derive(Debug, Clone, Copy, PartialEq)]
enum White {
    Known,
    /// The largest count of the type is taken.
    Doubtful(f64),
}

/// Returns the value of a band from those of each band, or the one for all. `None` if there is none.
fn of_band<T: Copy>(values: &[T], band: usize) -> Option<T> {
    values.get(band).or(values.first()).copied()
}

/// Returns factor and offset of each band, times its light.
fn scaled_bands(array: &Array, light: [f64; 3]) -> [(f64, f64); 3] {
    [0, 1, 2].map(|band| {
        let (factor, offset) = of_band(&array.scaling, band).unwrap_or((1.0, 0.0));
        (factor * light[band], offset * light[band])
    })
}

/// Conversion of stored values to light in [0, 1].
struct Scale<'a> {
    white: White,
    /// Factor and offset of each band.
    bands: [(f64, f64); 3],
    missing: &'a [f64],
    saturated: &'a [f64],
    table: Option<Table>,
    curve: Curve,
}

impl<'a> Scale<'a> {
    fn new(array: &'a Array, table: Option<Table>) -> Result<(Self, Vec<String>), PixelError> {
        let sample = array.sample;
        let with = |bands: [(f64, f64); 3], curve, note: String| {
            let scale = Scale {
                white: White::Known,
                bands,
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
            let (factor, curve, note): (f64, _, _) = match table {
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
            let (scale, notes) = with([(factor, 0.0); 3], curve, note)?;
            return Ok((Scale { table, ..scale }, notes));
        }
        let physical = !array.scaling.is_empty() || sample.kind == SampleKind::Float;
        let bands_times = |light: [f64; 3]| scaled_bands(array, light);
        match array.quantity {
            Quantity::Radiance if physical => {
                let note = format!("radiance to sRGB, white at {WHITE_RADIANCE} W/m2/sr/nm");
                with(bands_times([1.0 / WHITE_RADIANCE; 3]), Curve::Srgb, note)
            }
            Quantity::Reflectance if physical => {
                let sunlight = [0, 1, 2].map(|band| {
                    let light = of_band(&array.sunlight, band);
                    light.unwrap_or_else(|| sun::white_radiance(sun::BROAD_BAND_NM, None))
                });
                let white = sunlight.map(|light| format!("{:.3}", WHITE_RADIANCE / light));
                let mut white = white.to_vec();
                white.dedup();
                let note = format!("I/F to sRGB, white at {}", white.join(", "));
                with(
                    bands_times(sunlight.map(|light| light / WHITE_RADIANCE)),
                    Curve::Srgb,
                    note,
                )
            }
            _ if sample.kind == SampleKind::Float => Err(PixelError::UnknownQuantity),
            _ if sample.bytes == 1 && sample.kind == SampleKind::Unsigned => with(
                [(1.0 / 255.0, 0.0); 3],
                Curve::AsStored,
                "8-bit codes as stored".to_owned(),
            ),
            _ => {
                let whole = 8 * sample.bytes - u32::from(sample.kind == SampleKind::Signed);
                // A mask of fewer bits describes the detector, not values that were scaled since.
                let bits = array
                    .bits
                    .filter(|bits| array.scaling.is_empty() && *bits <= whole);
                let white = (1_u64 << bits.unwrap_or(whole).min(63)) as f64 - 1.0;
                let note = format!("counts to sRGB, white at {white}");
                let (mut scale, notes) = with([(1.0 / white, 0.0); 3], Curve::Srgb, note)?;
                if array.bits.is_none() {
                    scale.white = White::Doubtful(white);
                }
                Ok((scale, notes))
            }
        }
    }

    fn is_missing(&self, stored: f64) -> bool {
        stored.is_nan() || self.missing.contains(&stored)
    }

    fn is_saturated(&self, stored: f64) -> bool {
        self.saturated.contains(&stored)
    }

    /// Returns the light of a band, which may be below 0 or above 1. 0 for NaN.
    fn light(&self, band: usize, stored: f64) -> f64 {
        if stored.is_nan() {
            return 0.0;
        }
        if self.is_saturated(stored) {
            return 1.0;
        }
        let value = match self.table {
            Some(table) => f64::from(table.counts[stored.clamp(0.0, 255.0) as usize]),
            None => stored,
        };
        let (factor, offset) = self.bands[band];
        value * factor + offset
    }

    /// Returns the 8-bit code of light in [0, 1].
    fn code(&self, light: f32) -> u8 {
        if self.curve == Curve::AsStored {
            stored_code(light)
        } else {
            tone::code(light)
        }
    }
}

#[cfg(test)]
mod tests;
