//! TIFFs of 16 bits strip by strip: all strips at 16 bits would take twice the memory of the photo.

use std::io::Cursor;

use tiff::TiffError;
use tiff::decoder::{ChunkType, Decoder, DecodingResult};
use tiff::tags::Tag;

use super::tones::Tones;

/// Decoder of a TIFF in memory.
pub(super) type Tiff<'a> = Decoder<Cursor<&'a [u8]>>;

/// SampleFormat of unsigned integers.
const UNSIGNED: u16 = 1;

/// Reads pixels without opacity, each strip reduced to 8 bits before the next is read. `None` if the page has tiles or no unsigned integers
/// of 16 bits.
///
/// # Errors
/// A strip that is damaged.
pub(super) fn read(
    decoder: &mut Tiff<'_>,
    tones: &Tones,
    notes: &mut Vec<String>,
) -> Result<Option<Vec<u8>>, TiffError> {
    let formats = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat)?;
    let is_unsigned = formats.is_none_or(|formats| formats.iter().all(|format| *format == UNSIGNED));
    if !is_unsigned || decoder.get_chunk_type() != ChunkType::Strip {
        return Ok(None);
    }
    let white = tones.white_of_16_bits();
    let (width, height) = decoder.dimensions()?;
    let samples = usize::from(decoder.colortype()?.num_samples());
    let (mut reduced, mut most) = (Vec::with_capacity(width as usize * height as usize * samples), 0);
    for strip in 0..decoder.strip_count()? {
        let DecodingResult::U16(samples) = decoder.read_chunk(strip)? else {
            return Ok(None);
        };
        most = samples.iter().copied().fold(most, u16::max);
        let code = |sample: &u16| (f64::from(*sample) / white * 255.0 + 0.5) as u8;
        reduced.extend(samples.iter().map(code));
    }
    tones.note_16_bits(most, notes);
    Ok(Some(reduced))
}
