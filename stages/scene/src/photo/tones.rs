//! Which sample of a TIFF is white.

use std::io::{Read, Seek};

use tiff::TiffError;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

/// White level of a DNG, which other programs write too.
const WHITE_LEVEL: Tag = Tag::Unknown(50_717);
/// Largest 12-bit sample.
const TWELVE_BITS: f64 = 4095.0;

/// What the tags of a TIFF say of its tones.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Tones {
    /// Largest sample, which is white, with the name of its tag.
    largest: Option<(f64, &'static str)>,
}

impl Tones {
    /// Reads WhiteLevel, SMaxSampleValue or MaxSampleValue, in this order.
    ///
    /// # Errors
    /// A directory that is damaged.
    pub fn from_tags<R: Read + Seek>(decoder: &mut Decoder<R>) -> Result<Self, TiffError> {
        let tags = [
            (WHITE_LEVEL, "WhiteLevel"),
            (Tag::SMaxSampleValue, "SMaxSampleValue"),
            (Tag::MaxSampleValue, "MaxSampleValue"),
        ];
        for (tag, name) in tags {
            let largest = decoder.find_tag(tag)?.as_ref().and_then(largest);
            if let Some(largest) = largest.filter(|largest| *largest > 0.0 && largest.is_finite()) {
                return Ok(Self {
                    largest: Some((largest, name)),
                });
            }
        }
        Ok(Self::default())
    }

    /// Returns samples of 8 or 16 bits over their whole range. Other types are reduced to 8 bits, with a note.
    ///
    /// Integers of 8 and 16 bits without a tag are white at their type's largest number. MaxSampleValue is often the largest sample that
    /// occurs, so it counts only if all its bits are ones. Without a tag for white in 32-bit integers and floats, the smallest usual range
    /// that holds them is taken, and the note says so.
    pub fn displayed(&self, samples: DecodingResult, notes: &mut Vec<String>) -> DecodingResult {
        let format = Format::from_samples(&samples);
        let white = self.white(format, notes, || Statistics::from_samples(&samples));
        if matches!(samples, DecodingResult::U8(_) | DecodingResult::U16(_)) && white == format.white {
            return samples;
        }
        notes.push(format!("{} from 0 to {white} reduced to 8 bits", format.name));
        let code = |sample: f64| (sample / white * 255.0 + 0.5) as u8; // negative and NaN are 0
        DecodingResult::U8(numbers(&samples).map(code).collect())
    }

    /// Returns the white level of 16-bit integers, which only the tags decide.
    pub fn white_of_16_bits(&self) -> f64 {
        let tagged = self.tagged(Format::SIXTEEN_BITS);
        tagged.map_or(Format::SIXTEEN_BITS.white, |(largest, _)| largest)
    }

    /// Notes what [`Tones::displayed`] does of 16-bit integers with this largest one.
    pub fn note_16_bits(&self, most: u16, notes: &mut Vec<String>) {
        let format = Format::SIXTEEN_BITS;
        let statistics = Statistics {
            most: f64::from(most),
            mean: 0.0,
        };
        let white = self.white(format, notes, || statistics);
        if white != format.white {
            notes.push(format!("{} from 0 to {white} reduced to 8 bits", format.name));
        }
    }

    fn tagged(&self, format: Format) -> Option<(f64, &'static str)> {
        self.largest.filter(|(largest, _)| format.may_be_white(*largest))
    }

    fn white(&self, format: Format, notes: &mut Vec<String>, statistics: impl FnOnce() -> Statistics) -> f64 {
        if format == Format::EIGHT_BITS {
            return format.white;
        }
        if let Some((largest, name)) = self.tagged(format) {
            if largest != format.white {
                notes.push(format!("white is {largest} by its tag {name}"));
            }
            return largest;
        }
        let statistics = statistics();
        let (white, is_sure) = format.guess(&statistics);
        if !is_sure {
            let most = statistics.most;
            notes.push(format!(
                "doubtful tones: the largest sample is {most} and no tag defines white, so {white} is taken (set the tag SMaxSampleValue)"
            ));
        }
        white
    }
}

/// Returns the largest number of a tag, which may have one for each channel.
fn largest(value: &Value) -> Option<f64> {
    match value {
        Value::List(values) => values.iter().filter_map(largest).reduce(f64::max),
        Value::Byte(number) => Some(f64::from(*number)),
        Value::Short(number) => Some(f64::from(*number)),
        Value::Unsigned(number) => Some(f64::from(*number)),
        Value::UnsignedBig(number) => Some(*number as f64),
        Value::Signed(number) => Some(f64::from(*number)),
        Value::SignedShort(number) => Some(f64::from(*number)),
        Value::Float(number) => Some(f64::from(*number)),
        Value::Double(number) => Some(*number),
        Value::Rational(over, under) => Some(f64::from(*over) / f64::from(*under)),
        _ => None,
    }
}

/// A type of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Format {
    name: &'static str,
    /// Largest number of an integer type, or 1 for floats.
    white: f64,
    is_float: bool,
}

impl Format {
    const EIGHT_BITS: Self = Self::integers("8-bit integers", 255.0);
    const SIXTEEN_BITS: Self = Self::integers("16-bit integers", 65_535.0);

    const fn integers(name: &'static str, white: f64) -> Self {
        Self {
            name,
            white,
            is_float: false,
        }
    }

    fn from_samples(samples: &DecodingResult) -> Self {
        let (name, white, is_float) = match samples {
            DecodingResult::U8(_) => return Self::EIGHT_BITS,
            DecodingResult::U16(_) => return Self::SIXTEEN_BITS,
            DecodingResult::U32(_) => ("32-bit integers", f64::from(u32::MAX), false),
            DecodingResult::U64(_) => ("64-bit integers", u64::MAX as f64, false),
            DecodingResult::I8(_) => ("signed 8-bit integers", 127.0, false),
            DecodingResult::I16(_) => ("signed 16-bit integers", 32_767.0, false),
            DecodingResult::I32(_) => ("signed 32-bit integers", f64::from(i32::MAX), false),
            DecodingResult::I64(_) => ("signed 64-bit integers", i64::MAX as f64, false),
            DecodingResult::F16(_) => ("16-bit floats", 1.0, true),
            DecodingResult::F32(_) => ("32-bit floats", 1.0, true),
            DecodingResult::F64(_) => ("64-bit floats", 1.0, true),
        };
        Self {
            name,
            white,
            is_float,
        }
    }

    /// Returns whether the number of a tag can be the range of the type, and not only the largest sample that occurs.
    fn may_be_white(&self, largest: f64) -> bool {
        let all_ones = (largest + 1.0).log2().fract() == 0.0;
        all_ones && (self.is_float || largest <= self.white)
    }

    /// Returns the white level without a tag, and whether it is sure.
    fn guess(&self, statistics: &Statistics) -> (f64, bool) {
        let most = statistics.most;
        let usual = |most: f64| USUAL.into_iter().find(|white| *white >= most);
        if self.is_float {
            // A few highlights above 1 are clipped. Where the mean is above it, 1 cannot be white.
            return if statistics.mean <= 1.0 {
                (1.0, most <= 1.0)
            } else {
                (usual(most / OVERSHOOT).unwrap_or(most), false)
            };
        }
        if self.white <= 65_535.0 {
            return (
                self.white,
                most > TWELVE_BITS || self.white < TWELVE_BITS || most <= 0.0,
            );
        }
        match usual(most) {
            Some(white) if white < self.white => (white, false),
            _ => (self.white, true),
        }
    }
}

/// Ranges that programs write.
const USUAL: [f64; 4] = [255.0, 65_535.0, 16_777_215.0, 4_294_967_295.0];
/// Largest float over its range: sharpening and resampling go beyond it.
const OVERSHOOT: f64 = 1.1;

/// Largest and mean sample. NaN and infinities are left out.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Statistics {
    most: f64,
    mean: f64,
}

impl Statistics {
    fn from_samples(samples: &DecodingResult) -> Self {
        let (mut most, mut sum, mut count) = (0.0_f64, 0.0, 0_u64);
        for sample in numbers(samples).filter(|sample| sample.is_finite()) {
            most = most.max(sample);
            sum += sample;
            count += 1;
        }
        Self {
            most,
            mean: sum / count.max(1) as f64,
        }
    }
}

/// Returns samples of any type as numbers.
fn numbers(samples: &DecodingResult) -> Box<dyn Iterator<Item = f64> + '_> {
    match samples {
        DecodingResult::U8(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::U16(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::U32(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::U64(samples) => Box::new(samples.iter().map(|sample| *sample as f64)),
        DecodingResult::I8(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::I16(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::I32(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::I64(samples) => Box::new(samples.iter().map(|sample| *sample as f64)),
        DecodingResult::F16(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::F32(samples) => Box::new(samples.iter().map(|sample| f64::from(*sample))),
        DecodingResult::F64(samples) => Box::new(samples.iter().copied()),
    }
}
