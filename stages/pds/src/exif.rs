//! Camera facts from the EXIF of a photo.

use std::io::Cursor;

use exif::{Error, Exif, Field, In, Reader, Tag};

/// Longer side of a frame of 35 mm film, mm.
const FILM_SIDE_MM: f64 = 36.0;
/// Plausible focal lengths, in longer sides of the photo: 3.6 mm to 1800 mm on 35 mm film.
const BELIEVED: std::ops::RangeInclusive<f64> = 0.1..=50.0;
/// Longest name of a device, characters.
const MAX_DEVICE: usize = 80;

/// Camera facts of EXIF.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Lens {
    /// Focal length, pixels of the photo.
    pub focal_px: Option<f64>,
    /// Make and model.
    pub device: Option<String>,
    /// What could not be used, and why.
    pub notes: Vec<String>,
}

/// Reads the EXIF of a JPEG, PNG or WebP of this many pixels along its longer side.
///
/// The focal length is f₃₅ / 36 × longer side from FocalLengthIn35mmFilm. If that is absent or 0 (unknown), it is
/// FocalLength × FocalPlaneXResolution, scaled by the longer side over that of PixelXDimension and PixelYDimension.
/// Those resolutions are of the photo as taken.
///
/// # Extremes
/// A photo without EXIF gives no facts. Damaged EXIF is left out with a note, never an error. The same holds for a
/// number that is 0, infinite or not a focal length between 0.1 and 50 longer sides.
pub fn read(bytes: &[u8], longer_px: u32) -> Lens {
    let mut lens = Lens::default();
    if bytes.starts_with(b"GIF8") {
        return lens; // the one format of ours that has none
    }
    let mut reader = Reader::new();
    reader.continue_on_error(true);
    let read = match behind_prefix(bytes) {
        Some(exif) => reader.read_raw(exif.to_vec()),
        None => reader.read_from_container(&mut Cursor::new(bytes)),
    };
    let whole = read.or_else(|error| {
        error.distill_partial_result(|errors| {
            let first = errors.first().map(ToString::to_string).unwrap_or_default();
            lens.notes.push(format!("EXIF is damaged: {first}"));
        })
    });
    let exif = match whole {
        Ok(exif) => exif,
        Err(Error::NotFound(_)) => return lens,
        Err(error) => {
            lens.notes.push(format!("EXIF cannot be read: {error}"));
            return lens;
        }
    };
    lens.device = device(&exif);
    match focal_px(&exif, f64::from(longer_px)) {
        Some(focal_px) if BELIEVED.contains(&(focal_px / f64::from(longer_px))) => {
            lens.focal_px = Some(focal_px);
        }
        Some(focal_px) => {
            let note = format!(
                "EXIF's focal length of {focal_px:.0} px is not believed: the photo has {longer_px} px"
            );
            lens.notes.push(note);
        }
        None => {}
    }
    lens
}

/// Returns the EXIF of a WebP behind the prefix `Exif\0\0`, which belongs to JPEG and which some programs write.
/// `None` without the prefix.
fn behind_prefix(bytes: &[u8]) -> Option<&[u8]> {
    let mut rest = bytes.strip_prefix(b"RIFF")?.get(8..)?;
    loop {
        let (head, body) = rest.split_first_chunk::<8>()?;
        let [name @ .., a, b, c, d] = head;
        let size = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
        if name == b"EXIF" {
            return body.get(..size)?.strip_prefix(b"Exif\0\0");
        }
        rest = body.get(size.checked_next_multiple_of(2)?..)?;
    }
}

fn focal_px(exif: &Exif, longer_px: f64) -> Option<f64> {
    let number = |tag| positive(exif.get_field(tag, In::PRIMARY)?);
    if let Some(film_mm) = number(Tag::FocalLengthIn35mmFilm) {
        return Some(film_mm / FILM_SIDE_MM * longer_px);
    }
    let unit_mm = match exif
        .get_field(Tag::FocalPlaneResolutionUnit, In::PRIMARY)
        .map(|unit| unit.value.get_uint(0))
    {
        None | Some(Some(2)) => 25.4,
        Some(Some(3)) => 10.0,
        // Beyond the standard, but written by cameras.
        Some(Some(4)) => 1.0,
        Some(Some(5)) => 1e-3,
        _ => return None,
    };
    let taken_px = number(Tag::PixelXDimension)
        .into_iter()
        .chain(number(Tag::PixelYDimension))
        .fold(0.0, f64::max);
    let scale = if taken_px > 0.0 { longer_px / taken_px } else { 1.0 };
    Some(number(Tag::FocalLength)? * number(Tag::FocalPlaneXResolution)? / unit_mm * scale)
}

/// Returns a finite number above 0. A fraction over 0 is `None`, and so is 0, which means unknown.
fn positive(field: &Field) -> Option<f64> {
    let number = match &field.value {
        exif::Value::Rational(all) => all.first()?.to_f64(),
        value => f64::from(value.get_uint(0)?),
    };
    (number.is_finite() && number > 0.0).then_some(number)
}

fn device(exif: &Exif) -> Option<String> {
    let words = [Tag::Make, Tag::Model].into_iter().filter_map(|tag| {
        let exif::Value::Ascii(texts) = &exif.get_field(tag, In::PRIMARY)?.value else {
            return None;
        };
        let text = String::from_utf8_lossy(texts.first()?).replace(char::is_control, " ");
        Some(text.trim().to_owned()).filter(|text| !text.is_empty())
    });
    let name: String = words
        .collect::<Vec<_>>()
        .join(" ")
        .chars()
        .take(MAX_DEVICE)
        .collect();
    Some(name.trim_end().to_owned()).filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests;
