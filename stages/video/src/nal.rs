//! Units of an H.264 byte stream (ITU-T H.264, annex B) as samples of an MP4 file.

use crate::{mp4::boxed, sample::Sample};

/// Units of one picture.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Units {
    /// Sequence parameter set, without start code.
    pub sps: Option<Vec<u8>>,
    /// Picture parameter set, without start code.
    pub pps: Option<Vec<u8>>,
    /// The slices, each behind its length in 4 bytes.
    pub sample: Vec<u8>,
    /// Whether decoding can begin here.
    pub is_key: bool,
}

/// Types of units (table 7-1).
const SLICE: u8 = 1;
const KEY_SLICE: u8 = 5;
const SPS: u8 = 7;
const PPS: u8 = 8;

impl Units {
    /// Adds a unit that begins with its start code. Only slices and parameter sets are kept.
    pub fn add(&mut self, unit: &[u8]) {
        let unit = without_start_code(unit);
        match unit.first().map(|header| header & 0x1f) {
            Some(SPS) => self.sps = Some(unit.to_vec()),
            Some(PPS) => self.pps = Some(unit.to_vec()),
            Some(kind @ (SLICE | KEY_SLICE)) => {
                self.is_key |= kind == KEY_SLICE;
                // A picture has at most 3840 x 2160 pixels: its slices are far below 4 GiB.
                self.sample.extend((unit.len() as u32).to_be_bytes());
                self.sample.extend(unit);
            }
            _ => {}
        }
    }
}

impl Units {
    /// Returns the sample, with its `avcC` where both parameter sets came with it.
    pub fn into_sample(self) -> Sample {
        let sets = self.sps.as_deref().zip(self.pps.as_deref());
        Sample {
            config: sets.and_then(|(sps, pps)| avcc(sps, pps)),
            is_key: self.is_key,
            bytes: self.sample,
        }
    }
}

/// Profile, level and parameter sets (ISO/IEC 14496-15, section 5.3.3.1). Lengths of units have 4 bytes.
fn avcc(sps: &[u8], pps: &[u8]) -> Option<Vec<u8>> {
    let [_, profile, compatible, level] = *sps.first_chunk()?;
    let length = |set: &[u8]| (set.len() as u16).to_be_bytes();
    Some(boxed(
        b"avcC",
        &[
            &[1, profile, compatible, level, 0xfc | 3, 0xe0 | 1],
            &length(sps),
            sps,
            &[1],
            &length(pps),
            pps,
        ],
    ))
}

/// Takes the zeros and the one off that stand before every unit.
fn without_start_code(unit: &[u8]) -> &[u8] {
    let zeros = unit.iter().take_while(|byte| **byte == 0).count();
    match unit.get(zeros) {
        Some(1) if zeros >= 2 => &unit[zeros + 1..],
        _ => unit,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_become_parameter_sets_and_samples_with_lengths() {
        let mut units = Units::default();
        for unit in [
            &[0, 0, 0, 1, 0x67, 66, 192, 30][..],
            &[0, 0, 1, 0x68, 1],
            &[0, 0, 0, 1, 0x06, 9, 9],
            &[0, 0, 0, 1, 0x65, 0, 0, 3],
            &[0, 0, 1, 0x65, 7],
        ] {
            units.add(unit);
        }
        assert_eq!(units.sps.as_deref(), Some(&[0x67, 66, 192, 30][..]));
        assert_eq!(units.pps.as_deref(), Some(&[0x68, 1][..]));
        assert_eq!(units.sample, [0, 0, 0, 4, 0x65, 0, 0, 3, 0, 0, 0, 2, 0x65, 7]);
        let sample = units.into_sample();
        assert!(sample.is_key);
        let avcc = b"\0\0\0\x19avcC\x01\x42\xc0\x1e\xff\xe1\0\x04\x67\x42\xc0\x1e\x01\0\x02\x68\x01";
        assert_eq!(sample.config.as_deref(), Some(&avcc[..]));
    }

    #[test]
    fn a_predicted_picture_is_no_key_and_nothing_is_nothing() {
        let mut units = Units::default();
        units.add(&[]);
        units.add(&[0, 0, 0]);
        assert_eq!(units, Units::default());
        units.add(&[0, 0, 0, 1, 0x41, 5]);
        assert!(!units.is_key && units.sample == [0, 0, 0, 2, 0x41, 5]);
        assert_eq!(units.into_sample().config, None);
    }
}
