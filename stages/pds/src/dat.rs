//! Compressed raw products of Mastcam, MAHLI and MARDI of Curiosity (`.DAT`).
//!
//! A header of 64 bytes, then the pixels: an array, a JPEG, or Huffman codes of the differences of neighbours, in which the four
//! positions of the colour mosaic are planes of their own (reference: MSL MMM EDR and RDR data product SIS, section 4.4.3).

use std::sync::OnceLock;

use marf_scene::Photo;

use crate::label::{Array, BayerPhase, Sample, SampleKind};

/// Bytes of the header.
const HEADER: usize = 64;
/// Last word of the header.
const MAGIC: u32 = 0x1010_cc28;
/// Word before each plane of Huffman codes.
const SYNC: [u8; 4] = [0xff, 0xff, 0, 0];
/// Lines that are compressed together.
const BLOCK_LINES: usize = 8;
/// Longest Huffman code, bits.
const MAX_BITS: u8 = 15;
/// Number of the table of counts that are not companded.
const NO_TABLE: u32 = 255;
/// Largest count of the detector.
const MAX_COUNT: u16 = 4095;

/// A product that cannot be decompressed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DatError {
    /// The file ends before the pixels that its header describes.
    #[error("the compressed product is cut short: its header describes {lines} lines, it has {has}")]
    Short {
        /// Lines by the header.
        lines: u32,
        /// Whole lines in the file.
        has: u32,
    },
    /// The JPEG in it cannot be decoded, or is of another size.
    #[error("the JPEG of the compressed product is damaged: {0}")]
    Jpeg(String),
    /// Samples of 16 bits that have more than 12 bits in either order of their bytes.
    #[error("the samples of the compressed product are not counts of 12 bits")]
    Counts,
    /// A size that is not compressed like this.
    #[error("a compressed product of {0} x {1} pixels is not read: its sides must be multiples of 8")]
    Size(u32, u32),
}

/// A decompressed product.
pub struct Decompressed {
    /// The array in `bytes`.
    pub array: Array,
    /// Its samples.
    pub bytes: Vec<u8>,
    /// Where on the detector it starts.
    pub phase: BayerPhase,
}

/// What the header says.
struct Header {
    width: u32,
    height: u32,
    phase: BayerPhase,
    packing: Packing,
    table: u32,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Packing {
    Raw,
    Huffman,
    Jpeg,
}

/// Whether bytes begin with the header of a compressed product.
pub fn is_compressed(bytes: &[u8]) -> bool {
    word(bytes, 15) == Some(MAGIC)
}

fn word(bytes: &[u8], index: usize) -> Option<u32> {
    let four = bytes.get(4 * index..4 * index + 4)?;
    Some(u32::from_be_bytes(four.try_into().ok()?))
}

impl Header {
    fn read(bytes: &[u8]) -> Option<Self> {
        let [column, row, width, height] = word(bytes, 5)?.to_be_bytes().map(|side| 8 * u32::from(side));
        let [.., color, quality] = word(bytes, 8)?.to_be_bytes();
        Some(Self {
            // 0 is a whole line or column of the detector.
            width: if width == 0 { 1648 } else { width },
            height: if height == 0 { 1200 } else { height },
            phase: BayerPhase {
                line: row,
                sample: column,
            },
            packing: match (color, quality) {
                (0, 0) => Packing::Raw,
                (_, 0) => Packing::Huffman,
                _ => Packing::Jpeg,
            },
            table: word(bytes, 9)?,
        })
    }
}

/// Decompresses a product. `None` if the bytes do not begin with its header.
///
/// # Errors
/// See [`DatError`].
pub fn decompress(bytes: &[u8], limit_bytes: u64) -> Option<Result<Decompressed, DatError>> {
    let header = Header::read(bytes).filter(|_| is_compressed(bytes))?;
    let body = &bytes[HEADER..];
    let samples = match header.packing {
        Packing::Raw => raw(&header, body),
        Packing::Huffman => huffman(&header, bytes).map(|samples| (samples, 1)),
        Packing::Jpeg => jpeg(&header, body, limit_bytes).map(|samples| (samples, 1)),
    };
    Some(samples.map(|(samples, bytes)| header.decompressed(samples, bytes)))
}

impl Header {
    fn decompressed(&self, samples: Vec<u8>, sample_bytes: u32) -> Decompressed {
        let band = u64::from(self.width) * u64::from(self.height) * u64::from(sample_bytes);
        let bands = if samples.len() as u64 == 3 * band { 3 } else { 1 };
        let companded = sample_bytes == 1 && self.table != NO_TABLE;
        Decompressed {
            array: Array {
                shape: [bands, self.height, self.width],
                sample: Sample {
                    kind: SampleKind::Unsigned,
                    bytes: sample_bytes,
                    big_endian: true,
                },
                bits: Some(if sample_bytes == 1 { 8 } else { 12 }),
                companded_by: companded.then(|| format!("MMM_LUT{}", self.table)),
                ..Array::default()
            },
            bytes: samples,
            phase: self.phase,
        }
    }

    fn short(&self, lines: usize) -> DatError {
        DatError::Short {
            lines: self.height,
            has: lines as u32,
        }
    }
}

/// Returns an array of samples and their size. Those of 16 bits get the most significant byte first.
fn raw(header: &Header, body: &[u8]) -> Result<(Vec<u8>, u32), DatError> {
    let size: u32 = if header.table == NO_TABLE { 2 } else { 1 };
    let line = (header.width * size) as usize;
    let needed = line * header.height as usize;
    let samples = body
        .get(..needed)
        .ok_or_else(|| header.short(body.len() / line))?;
    if size == 1 {
        return Ok((samples.to_vec(), 1));
    }
    let pairs = || samples.as_chunks::<2>().0.iter().copied();
    let fits = |read: fn([u8; 2]) -> u16| pairs().all(|pair| read(pair) <= MAX_COUNT);
    if fits(u16::from_be_bytes) {
        return Ok((samples.to_vec(), 2));
    }
    if fits(u16::from_le_bytes) {
        return Ok((pairs().flat_map(|[low, high]| [high, low]).collect(), 2));
    }
    Err(DatError::Counts)
}

/// Returns the samples of the JPEG, band by band.
fn jpeg(header: &Header, body: &[u8], limit_bytes: u64) -> Result<Vec<u8>, DatError> {
    // The file is padded behind the picture.
    let end = body
        .windows(2)
        .rposition(|pair| pair == [0xff, 0xd9])
        .map_or(body.len(), |at| at + 2);
    let photo =
        Photo::decode_within(&body[..end], limit_bytes).map_err(|error| DatError::Jpeg(error.to_string()))?;
    let (width, height) = (photo.image.width, photo.image.height);
    if (width, height) != (header.width, header.height) {
        let expected = format!(
            "{width} x {height} pixels, the header describes {} x {}",
            header.width, header.height
        );
        return Err(DatError::Jpeg(expected));
    }
    let bands = 0..usize::from(photo.bands);
    Ok(bands
        .flat_map(|band| photo.image.pixels.iter().map(move |pixel| pixel[band]))
        .collect())
}

/// Returns the samples of a mosaic whose four planes are compressed in blocks of eight lines.
fn huffman(header: &Header, bytes: &[u8]) -> Result<Vec<u8>, DatError> {
    let (width, height) = (header.width as usize, header.height as usize);
    if width % 2 != 0 || height % BLOCK_LINES != 0 {
        return Err(DatError::Size(header.width, header.height));
    }
    let mut samples = vec![0; width * height];
    let mut bits = Bits {
        bytes,
        at: 8 * HEADER,
    };
    for (index, block) in samples.chunks_exact_mut(BLOCK_LINES * width).enumerate() {
        for plane in 0..4 {
            let places = (0..BLOCK_LINES / 2).flat_map(|line| {
                let first = (2 * line + plane / 2) * width + plane % 2;
                (0..width / 2).map(move |sample| first + 2 * sample)
            });
            bits.plane(block, places)
                .ok_or_else(|| header.short(index * BLOCK_LINES))?;
        }
    }
    Ok(samples)
}

/// A reader of bits, the highest of a byte first.
struct Bits<'a> {
    bytes: &'a [u8],
    /// Next bit.
    at: usize,
}

impl Bits<'_> {
    /// Reads a plane of a block: differences of successive samples. `None` if the file ends before.
    fn plane(&mut self, block: &mut [u8], places: impl Iterator<Item = usize>) -> Option<()> {
        // A plane begins at a word of four bytes.
        let from = self.at.div_ceil(32) * 4;
        let rest = self.bytes.get(from..)?;
        let sync = rest.windows(4).position(|word| word == SYNC)?;
        self.at = 8 * (from + sync + SYNC.len());
        let mut sample = 0_u8;
        for place in places {
            sample = sample.wrapping_add(self.difference()?);
            block[place] = sample;
        }
        Some(())
    }

    fn difference(&mut self) -> Option<u8> {
        let byte = |index: usize| self.bytes.get(self.at / 8 + index).copied().map(u32::from);
        // Beyond the end zeros are read. The length of the code decides whether it was whole.
        let three = byte(0)? << 16 | byte(1).unwrap_or(0) << 8 | byte(2).unwrap_or(0);
        let next = three >> (24 - MAX_BITS as usize - self.at % 8) & ((1 << MAX_BITS) - 1);
        let (length, difference) = codes()[next as usize];
        self.at += usize::from(length);
        (self.at <= 8 * self.bytes.len()).then_some(difference)
    }
}

/// Returns length and difference by the next bits.
fn codes() -> &'static [(u8, u8)] {
    static CODES: OnceLock<Vec<(u8, u8)>> = OnceLock::new();
    CODES.get_or_init(|| {
        let pairs = LENGTHS.iter().zip(&DIFFERENCES);
        pairs
            .flat_map(|(length, difference)| {
                std::iter::repeat_n((*length, *difference), 1 << (MAX_BITS - length))
            })
            .collect()
    })
}

/// Lengths of the Huffman codes in the order of the codes, bits.
#[rustfmt::skip]
static LENGTHS: [u8; 256] = [
    9, 10, 11, 11, 13, 13, 12, 12, 15, 15, 14, 13, 10, 9, 7, 6, 6, 7, 8, 8, 4, 4, 4, 5, 5, 9, 10, 11, 11, 12,
    12, 13, 14, 15, 15, 12, 10, 9, 7, 6, 6, 7, 8, 8, 4, 4, 9, 10, 11, 11, 12, 15, 15, 15, 15, 15, 15, 15, 15,
    15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
    15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
    15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
    15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
    15, 15, 15, 15, 15, 15, 15, 15, 7, 6, 5, 5, 6, 7, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
    15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
    15, 15, 15, 15, 15, 15, 14, 13, 13, 14, 14, 13, 9, 8, 4, 4, 8, 9, 10, 10, 11, 11, 12, 12, 13, 14, 14, 13,
    13, 9, 8, 6, 5, 5, 6, 7, 7, 4, 4,
];

/// Differences that the codes stand for, modulo 256.
#[rustfmt::skip]
static DIFFERENCES: [u8; 256] = [
    237, 23, 27, 229, 221, 35, 225, 31, 42, 169, 216, 220, 232, 236, 12, 248, 8, 244, 240, 16, 0, 255, 1, 251,
    5, 20, 24, 28, 228, 32, 224, 36, 40, 170, 166, 223, 25, 235, 13, 247, 9, 243, 239, 17, 2, 254, 21, 231,
    29, 227, 33, 168, 167, 165, 162, 161, 160, 159, 158, 171, 164, 155, 163, 157, 152, 151, 150, 149, 148,
    147, 146, 145, 144, 143, 142, 156, 154, 139, 138, 137, 136, 135, 153, 141, 132, 131, 130, 129, 194, 195,
    196, 125, 124, 197, 198, 121, 120, 119, 118, 117, 199, 200, 114, 113, 112, 111, 110, 109, 140, 134, 106,
    105, 104, 103, 102, 188, 180, 181, 172, 173, 174, 133, 108, 93, 92, 91, 90, 89, 88, 87, 86, 85, 84, 83,
    82, 81, 80, 79, 78, 77, 76, 75, 74, 73, 72, 71, 70, 69, 68, 67, 66, 65, 64, 63, 62, 61, 60, 59, 58, 57,
    56, 55, 54, 53, 52, 51, 50, 49, 48, 47, 46, 14, 246, 250, 6, 10, 242, 45, 44, 107, 95, 175, 176, 177, 178,
    183, 184, 185, 186, 190, 191, 192, 201, 202, 203, 204, 205, 206, 207, 208, 209, 210, 211, 212, 94, 179,
    182, 97, 96, 187, 189, 99, 98, 193, 101, 100, 116, 115, 123, 122, 126, 127, 128, 41, 37, 219, 215, 214,
    218, 234, 238, 253, 3, 18, 22, 26, 230, 30, 226, 222, 34, 38, 43, 213, 217, 39, 233, 19, 245, 249, 7, 11,
    241, 15, 4, 252,
];

#[cfg(test)]
mod tests;
