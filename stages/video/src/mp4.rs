//! The boxes of an MP4 file with one track (ISO/IEC 14496-12).
//!
//! ```text
//! ftyp
//! moov ─┬─ mvhd
//!       └─ trak ─┬─ tkhd
//!                └─ mdia ─┬─ mdhd, hdlr
//!                         └─ minf ─┬─ vmhd, dinf (dref)
//!                                  └─ stbl: stsd (avc1: avcC, colr, pasp), stts, stss, stsc, stsz, stco
//! mdat
//! ```
//! `moov` stands before the samples, so that a player starts before it has read all (fast start). All samples are one chunk: its
//! place is always within the first 4 GiB, so no 64-bit table of places is needed. Times of creation are 0.

use crate::{VideoError, sample::Sample};

/// Units of time a picture takes. A second has `rate` times as many.
const TICKS: u32 = 1000;
/// 1.0 as 16.16.
const ONE: u32 = 0x1_0000;
/// Volume of the sound: the file has no sound.
const VOLUME: u16 = 0;
/// Rows of the matrix that leaves pictures as they are: 16.16, the last column 2.30.
const IDENTITY: [u32; 9] = [ONE, 0, 0, 0, ONE, 0, 0, 0, 0x4000_0000];
/// Language `und`: three letters of 5 bits.
const UNDETERMINED: u16 = 0x55c4;
/// BT.709 for primaries, transfer and matrix (ITU-T H.273, tables 2 to 4).
const BT709: u16 = 1;

/// Type of the entry that describes samples of H.264, and a brand of the file.
const ENTRY: &[u8; 4] = b"avc1";

/// Encoded pictures and what the file says of them.
#[derive(Debug)]
pub(crate) struct Track {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes of every picture.
    pub samples: Vec<u32>,
    rate: u32,
    /// The box of what a decoder has to know before the first picture.
    config: Vec<u8>,
    /// Pictures from which decoding can begin, from 1.
    keys: Vec<u32>,
    data: Vec<u8>,
}

impl Track {
    /// Returns a track without pictures.
    pub fn new(rate: u32) -> Self {
        Self {
            width: 0,
            height: 0,
            samples: Vec::new(),
            rate,
            config: Vec::new(),
            keys: Vec::new(),
            data: Vec::new(),
        }
    }

    /// Adds a picture.
    ///
    /// # Errors
    /// None encoded, or parameters other than those before: the file holds one set.
    pub fn add(&mut self, sample: Sample) -> Result<(), &'static str> {
        match sample.config {
            Some(config) if self.config.is_empty() => self.config = config,
            Some(config) if config != self.config => return Err("its parameters changed"),
            _ => {}
        }
        if self.config.is_empty() {
            return Err("it gave no parameters");
        }
        if sample.bytes.is_empty() {
            return Err("it gave nothing");
        }
        self.samples.push(sample.bytes.len() as u32);
        if sample.is_key {
            self.keys.push(self.samples.len() as u32);
        }
        self.data.extend(sample.bytes);
        Ok(())
    }

    /// Length in units of time.
    fn ticks(&self) -> u32 {
        (self.samples.len() as u32).saturating_mul(TICKS)
    }
}

/// Returns the file.
///
/// # Errors
/// A track without pictures, or of 4 GiB or more.
pub(crate) fn write(track: &Track) -> Result<Vec<u8>, VideoError> {
    if track.samples.is_empty() {
        return Err(VideoError::NoPictures);
    }
    let bytes = track.data.len() as u64;
    if bytes + 8 > u64::from(u32::MAX) {
        return Err(VideoError::TooLong { bytes });
    }
    let start = file_type();
    // The place of the samples has one length whatever it is.
    let offset = start.len() + movie(track, 0).len() + 8;
    let movie = movie(track, offset as u32);
    let samples = boxed(b"mdat", &[&track.data]);
    Ok([start, movie, samples].concat())
}

/// Returns a box: length, type, content.
pub(crate) fn boxed(kind: &[u8; 4], parts: &[&[u8]]) -> Vec<u8> {
    let content = parts.concat();
    let length = (content.len() + 8) as u32;
    [&length.to_be_bytes(), kind.as_slice(), &content].concat()
}

/// Returns a box whose content begins with a version, 0, and flags.
fn versioned(kind: &[u8; 4], flags: u32, parts: &[&[u8]]) -> Vec<u8> {
    boxed(kind, &[&flags.to_be_bytes(), &parts.concat()])
}

fn words(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_be_bytes()).collect()
}

fn halves(numbers: &[u16]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_be_bytes()).collect()
}

fn file_type() -> Vec<u8> {
    let brands: [&[u8]; 5] = [b"isom", &words(&[0x200]), b"isomiso2", ENTRY, b"mp41"];
    boxed(b"ftyp", &brands)
}

fn movie(track: &Track, offset: u32) -> Vec<u8> {
    let header = versioned(
        b"mvhd",
        0,
        &[
            &words(&[0, 0, track.rate * TICKS, track.ticks(), ONE]),
            &halves(&[VOLUME, 0]),
            &words(&[0, 0]),
            &words(&IDENTITY),
            &words(&[0; 6]),
            &words(&[2]), // number of the next track
        ],
    );
    boxed(b"moov", &[&header, &trak(track, offset)])
}

fn trak(track: &Track, offset: u32) -> Vec<u8> {
    // Enabled, part of the presentation.
    let header = versioned(
        b"tkhd",
        3,
        &[
            &words(&[0, 0, 1, 0, track.ticks(), 0, 0]),
            &halves(&[0, 0, VOLUME, 0]),
            &words(&IDENTITY),
            &words(&[track.width << 16, track.height << 16]),
        ],
    );
    boxed(b"trak", &[&header, &media(track, offset)])
}

fn media(track: &Track, offset: u32) -> Vec<u8> {
    let times = words(&[0, 0, track.rate * TICKS, track.ticks()]);
    let header = versioned(b"mdhd", 0, &[&times, &halves(&[UNDETERMINED, 0])]);
    let handler = versioned(b"hdlr", 0, &[&words(&[0]), b"vide", &words(&[0; 3]), b"video\0"]);
    let video = versioned(b"vmhd", 1, &[&halves(&[0; 4])]);
    // The samples are in this file: flag 1.
    let here = versioned(b"url ", 1, &[]);
    let places = boxed(b"dinf", &[&versioned(b"dref", 0, &[&words(&[1]), &here])]);
    let information = boxed(b"minf", &[&video, &places, &sample_tables(track, offset)]);
    boxed(b"mdia", &[&header, &handler, &information])
}

fn sample_tables(track: &Track, offset: u32) -> Vec<u8> {
    let count = track.samples.len() as u32;
    let descriptions = versioned(b"stsd", 0, &[&words(&[1]), &sample_entry(track)]);
    let times = versioned(b"stts", 0, &[&words(&[1, count, TICKS])]);
    let keys = versioned(
        b"stss",
        0,
        &[&words(&[track.keys.len() as u32]), &words(&track.keys)],
    );
    let chunks = versioned(b"stsc", 0, &[&words(&[1, 1, count, 1])]);
    let sizes = versioned(b"stsz", 0, &[&words(&[0, count]), &words(&track.samples)]);
    let places = versioned(b"stco", 0, &[&words(&[1, offset])]);
    boxed(b"stbl", &[&descriptions, &times, &keys, &chunks, &sizes, &places])
}

/// How samples are decoded and shown.
fn sample_entry(track: &Track) -> Vec<u8> {
    let dots_per_inch = 72 * ONE;
    let color = boxed(b"colr", &[b"nclx", &halves(&[BT709; 3]), &[0]]); // 0: limited range
    let square = boxed(b"pasp", &[&words(&[1, 1])]);
    boxed(
        ENTRY,
        &[
            &halves(&[0, 0, 0, 1]), // reserved, then the place of the data: the first
            &halves(&[0; 8]),
            &halves(&[track.width as u16, track.height as u16]),
            &words(&[dots_per_inch, dots_per_inch, 0]),
            &halves(&[1]),          // pictures a sample
            &[0; 32],               // name of the encoder
            &halves(&[24, 0xffff]), // depth in bits; no table of colours
            &track.config,
            &color,
            &square,
        ],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(bytes: usize, is_key: bool) -> Sample {
        Sample {
            config: is_key.then(|| boxed(b"avcC", &[&[1, 66]])),
            bytes: vec![7; bytes],
            is_key,
        }
    }

    #[test]
    fn a_box_is_length_type_and_content() {
        assert_eq!(
            boxed(b"free", &[&[1], &[2, 3]]),
            [0, 0, 0, 11, b'f', b'r', b'e', b'e', 1, 2, 3]
        );
        assert_eq!(versioned(b"free", 1, &[]).len(), 12);
    }

    /// The offset in `stco` is the place of the first sample.
    #[test]
    fn the_table_of_places_points_behind_the_header_of_the_data() {
        let mut track = Track::new(24);
        track.add(sample(5, true)).unwrap();
        track.add(sample(3, false)).unwrap();
        let file = write(&track).unwrap();
        let at = |name: &[u8; 4]| file.windows(4).position(|bytes| bytes == name).unwrap();
        let table = at(b"stco") + 4 + 4 + 4;
        let offset = u32::from_be_bytes(file[table..table + 4].try_into().unwrap()) as usize;
        assert_eq!(offset, at(b"mdat") + 4);
        assert_eq!(file[offset..], [7; 8]);
        assert!(at(b"moov") < at(b"mdat"));
    }

    #[test]
    fn parameters_that_are_missing_or_change_are_refused() {
        let mut track = Track::new(24);
        assert_eq!(track.add(sample(5, false)), Err("it gave no parameters"));
        track.add(sample(5, true)).unwrap();
        track.add(sample(5, true)).unwrap();
        let mut other = sample(5, true);
        other.config = Some(boxed(b"avcC", &[&[1, 67]]));
        assert_eq!(track.add(other), Err("its parameters changed"));
        assert_eq!(track.add(sample(0, false)), Err("it gave nothing"));
        assert_eq!(write(&Track::new(24)), Err(VideoError::NoPictures));
    }

    /// Readers choose by the entry and by the brand.
    #[test]
    fn entry_and_brand_are_those_of_the_codec() {
        let mut track = Track::new(24);
        track.add(sample(5, true)).unwrap();
        let file = write(&track).unwrap();
        assert_eq!(file.windows(4).filter(|bytes| bytes == b"avc1").count(), 2);
    }
}
