//! Pictures of 16 bits with text beside the pixels: heights, spreads, depths.

use png::{BitDepth, ColorType, Encoder};

use crate::SurfaceError;

/// Values of a picture of 16 bits without that of "nothing".
pub const MOST: f64 = 65_534.0;

/// Writes gray pixels of 16 bits, rows from the top, with `tEXt` chunks (keyword, text; Latin-1).
///
/// # Errors
/// [`SurfaceError::Encode`] for a picture without pixels or text that is not Latin-1.
pub fn gray(
    width: u32,
    height: u32,
    values: &[u16],
    text: &[(&str, String)],
) -> Result<Vec<u8>, SurfaceError> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
    encode(
        width,
        height,
        (ColorType::Grayscale, BitDepth::Sixteen),
        &bytes,
        text,
    )
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
) -> Result<Vec<u8>, SurfaceError> {
    encode(
        width,
        height,
        (ColorType::Rgba, BitDepth::Eight),
        pixels.as_flattened(),
        text,
    )
}

fn encode(
    width: u32,
    height: u32,
    (color, depth): (ColorType, BitDepth),
    pixels: &[u8],
    text: &[(&str, String)],
) -> Result<Vec<u8>, SurfaceError> {
    let failed = |error: png::EncodingError| SurfaceError::Encode {
        what: "a PNG",
        cause: error.to_string(),
    };
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    for (keyword, text) in text {
        encoder
            .add_text_chunk((*keyword).to_owned(), text.clone())
            .map_err(failed)?;
    }
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(pixels).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

/// Writes depths along the rays of a view as gray of 16 bits: `depth = value · step`, 0 where there is none.
///
/// `step` is the largest depth / 65,534, so that reading back is off by at most half of it; it stands in the text
/// `marf:depth-step`, its unit in `marf:depth-unit`.
///
/// - `depth`: `[height * width]`, world units; what is not finite or not above 0 counts as none.
/// - `metres`: metres a world unit, if known.
///
/// # Errors
/// As [`gray`].
pub fn depth(width: u32, height: u32, depth: &[f32], metres: Option<f64>) -> Result<Vec<u8>, SurfaceError> {
    let is_depth = |depth: &f32| depth.is_finite() && *depth > 0.0;
    let largest = depth.iter().copied().filter(is_depth).fold(0.0, f32::max);
    let scale = metres.unwrap_or(1.0);
    let step = if largest > 0.0 {
        f64::from(largest) * scale / MOST
    } else {
        1.0
    };
    let value = |depth: &f32| match is_depth(depth) {
        true => (f64::from(*depth) * scale / step).round().clamp(1.0, MOST) as u16,
        false => 0,
    };
    let values: Vec<u16> = depth.iter().map(value).collect();
    let unit = if metres.is_some() {
        "metre"
    } else {
        "unit of the scene, whose scale is not known"
    };
    let text = [
        ("marf:depth-step", step.to_string()),
        ("marf:depth-unit", unit.to_owned()),
        (
            "marf:depth-kind",
            "distance along the ray of a pixel; 0: none".to_owned(),
        ),
    ];
    gray(width, height, &values, &text)
}

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
}
