//! Pictures of 16 bits with text chunks: heights, spreads, depths.

use std::io::Cursor;

use png::{BitDepth, ColorType, Decoder, Encoder, Limits};

/// What keeps a picture from being written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a PNG could not be written: {0}")]
pub struct PngError(String);

impl From<png::EncodingError> for PngError {
    fn from(error: png::EncodingError) -> Self {
        Self(error.to_string())
    }
}

/// Values of a picture of 16 bits without that of "nothing".
pub const MOST: f64 = 65_534.0;

/// Writes gray pixels of 16 bits, rows from the top, with `tEXt` chunks (keyword and text in Latin-1).
///
/// # Errors
/// A picture without pixels, or text that is not Latin-1.
pub fn gray(width: u32, height: u32, values: &[u16], text: &[(&str, String)]) -> Result<Vec<u8>, PngError> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
    encode(width, height, ColorType::Grayscale, &bytes, text)
}

/// Writes colours with transparency, 4 bytes a pixel.
///
/// # Errors
/// As [`gray`].
pub fn rgba(
    width: u32,
    height: u32,
    pixels: &[[u8; 4]],
    text: &[(&str, String)],
) -> Result<Vec<u8>, PngError> {
    encode(width, height, ColorType::Rgba, pixels.as_flattened(), text)
}

/// Writes pixels: gray has 16 bits a channel, colours have 8.
fn encode(
    width: u32,
    height: u32,
    color: ColorType,
    pixels: &[u8],
    text: &[(&str, String)],
) -> Result<Vec<u8>, PngError> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(if color == ColorType::Grayscale {
        BitDepth::Sixteen
    } else {
        BitDepth::Eight
    });
    for (keyword, text) in text {
        encoder.add_text_chunk((*keyword).to_owned(), text.clone())?;
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(bytes)
}

/// Meaning of the values of a picture. It is stored in the texts `marf:NAME-step`, `marf:NAME-unit` and `marf:NAME-kind`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quantity<'a> {
    /// `depth`, `uncertainty`.
    pub name: &'a str,
    /// Unit of value · step.
    pub unit: &'a str,
    /// What it is, in one sentence.
    pub kind: &'a str,
}

/// Writes a quantity as gray of 16 bits: `factor · values = written · step`, written 0 where there is none.
///
/// `step` is the largest value / 65,534, so that reading back ([`read_quantity`]) is off by at most half of it. Values above 0 and below
/// half of it are off by up to one step. Values that are not finite or not above 0 are written as 0.
///
/// # Errors
/// As [`gray`].
pub fn quantity(
    width: u32,
    height: u32,
    values: &[f32],
    factor: f64,
    quantity: &Quantity<'_>,
) -> Result<Vec<u8>, PngError> {
    let is_some = |value: &f32| value.is_finite() && *value > 0.0;
    let largest = values.iter().copied().filter(is_some).fold(0.0, f32::max);
    let step = if largest > 0.0 {
        f64::from(largest) * factor / MOST
    } else {
        1.0
    };
    let write = |value: &f32| {
        if is_some(value) {
            (f64::from(*value) * factor / step).round().clamp(1.0, MOST) as u16
        } else {
            0
        }
    };
    let written: Vec<u16> = values.iter().map(write).collect();
    let Quantity { name, unit, kind } = quantity;
    let keywords = ["step", "unit", "kind"].map(|key| format!("marf:{name}-{key}"));
    let [step_key, unit_key, kind_key] = keywords.each_ref().map(String::as_str);
    let text = [
        (step_key, step.to_string()),
        (unit_key, (*unit).to_owned()),
        (kind_key, (*kind).to_owned()),
    ];
    gray(width, height, &written, &text)
}

/// Writes depths along the rays of a view ([`quantity`]).
///
/// - `depth`: `[height * width]`, world units.
/// - `metres`: metres a world unit, if known.
///
/// # Errors
/// As [`gray`].
pub fn depth(width: u32, height: u32, depth: &[f32], metres: Option<f64>) -> Result<Vec<u8>, PngError> {
    let of_depth = Quantity {
        name: "depth",
        unit: match metres {
            Some(_) => "metre",
            None => "unit of the scene, whose scale is not known",
        },
        kind: "distance along the ray of a pixel; 0: none",
    };
    quantity(width, height, depth, metres.unwrap_or(1.0), &of_depth)
}

/// Reads the quantity `name` that [`quantity`] wrote: width, height and values, 0 where there is none. `None` if the bytes are anything
/// else.
pub fn read_quantity(bytes: &[u8], name: &str) -> Option<(u32, u32, Vec<f32>)> {
    let limits = Limits { bytes: MOST_BYTES };
    let mut reader = Decoder::new_with_limits(Cursor::new(bytes), limits)
        .read_info()
        .ok()?;
    let mut pixels = vec![0; reader.output_buffer_size().filter(|bytes| *bytes <= MOST_BYTES)?];
    let info = reader.next_frame(&mut pixels).ok()?;
    if (info.color_type, info.bit_depth) != (ColorType::Grayscale, BitDepth::Sixteen) {
        return None;
    }
    let keyword = format!("marf:{name}-step");
    let texts = &reader.info().uncompressed_latin1_text;
    let step = texts.iter().find(|chunk| chunk.keyword == keyword)?;
    let step: f64 = step.text.parse().ok()?;
    let value = |written: &[u8; 2]| (f64::from(u16::from_be_bytes(*written)) * step) as f32;
    let values = pixels.as_chunks::<2>().0.iter().map(value).collect();
    Some((info.width, info.height, values))
}

/// Most bytes of the pixels of a picture that is read.
const MOST_BYTES: usize = 256 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads values and texts by the `image` and `png` crates.
    fn read(bytes: &[u8]) -> (Vec<u16>, Vec<(String, String)>) {
        let picture = image::load_from_memory(bytes).unwrap();
        let decoder = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        let text = decoder.info().uncompressed_latin1_text.iter();
        let text = text
            .map(|chunk| (chunk.keyword.clone(), chunk.text.clone()))
            .collect();
        (picture.into_luma16().into_raw(), text)
    }

    #[test]
    fn depths_come_back_to_half_a_step() {
        let depths = [0.01, 1.0, 3.333, 12.5, f32::INFINITY, f32::NAN, 0.0, -1.0];
        let (values, text) = read(&depth(4, 2, &depths, Some(2.0)).unwrap());
        let step: f64 = text[0].1.parse().unwrap();
        assert_eq!(text[0].0, "marf:depth-step");
        assert_eq!(text[1].1, "metre");
        for (value, depth) in values.iter().zip(&depths[..4]) {
            let error = (f64::from(*value) * step - f64::from(*depth) * 2.0).abs();
            assert!(error <= step / 2.0 + 1e-12, "{depth}: {error}");
        }
        assert_eq!(values[3], 65_534);
        assert_eq!(values[4..], [0; 4]);
    }

    #[test]
    fn a_picture_without_depths_is_black_and_one_without_pixels_is_refused() {
        let (values, text) = read(&depth(2, 1, &[f32::INFINITY; 2], None).unwrap());
        assert_eq!(values, [0, 0]);
        assert!(text[1].1.contains("scale is not known"));
        assert!(depth(0, 0, &[], None).is_err());
    }

    #[test]
    fn a_quantity_comes_back_by_its_name_alone() {
        let spread = Quantity {
            name: "uncertainty",
            unit: "sRGB, white = 1",
            kind: "standard deviation",
        };
        let values = [0.0, 1e-9, 0.02, 0.5];
        let png = quantity(2, 2, &values, 1.0, &spread).unwrap();
        let (width, height, back) = read_quantity(&png, "uncertainty").unwrap();
        assert_eq!((width, height), (2, 2));
        // Half of 0.5 / 65,534. Values above 0 stay above it.
        for (back, value) in back.iter().zip(values) {
            assert!((back - value).abs() <= 7.7e-6, "{value}: {back}");
        }
        assert!(back[0] == 0.0 && back[1] > 0.0, "{back:?}");
        assert_eq!(read_quantity(&png, "depth"), None);
        assert_eq!(read_quantity(&png[..png.len() / 2], "uncertainty"), None);
        assert_eq!(read_quantity(b"", "uncertainty"), None);
    }
}
