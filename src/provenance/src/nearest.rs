//! Finds the object that a file resembles most.

use std::collections::HashMap;

use marf_cache::Digest;

/// A stretch ends where this many low bits of the rolling hash are zero: after 64 bytes in the mean.
const END_BITS: u32 = 6;
/// As [`END_BITS`] for a file below [`SMALL_BYTES`]: after 8 bytes in the mean, so that one change leaves most stretches.
const SMALL_END_BITS: u32 = 3;
const SMALL_BYTES: usize = 4096;
/// Least share of a file that must be found in an object, for the file to be called a changed copy of it.
pub const LEAST_SHARE: f64 = 0.5;

/// The stretches of a file, by which it is compared with objects.
///
/// Stretches end where their content says so, so that a byte that was added or removed changes those around it alone.
pub struct Outline {
    bytes: usize,
    end_bits: u32,
    /// Bytes by digest of the stretch.
    stretches: HashMap<Digest, usize>,
}

impl Outline {
    /// Returns the outline of a file.
    pub fn new(file: &[u8]) -> Self {
        let end_bits = if file.len() < SMALL_BYTES {
            SMALL_END_BITS
        } else {
            END_BITS
        };
        let mut stretches: HashMap<Digest, usize> = HashMap::new();
        for stretch in stretches_of(file, end_bits) {
            *stretches.entry(Digest::from_content(stretch)).or_default() += stretch.len();
        }
        Self {
            bytes: file.len(),
            end_bits,
            stretches,
        }
    }

    /// Returns true if an object of this length can share enough with the file.
    pub fn may_resemble(&self, bytes: u64) -> bool {
        let (least, most) = (self.bytes.min(bytes as usize), self.bytes.max(bytes as usize));
        least as f64 >= LEAST_SHARE * most as f64
    }

    /// Returns the share of the longer of file and object that both have, in [0, 1].
    pub fn share_with(&self, object: &[u8]) -> f64 {
        let mut left = self.stretches.clone();
        let mut shared = 0;
        for stretch in stretches_of(object, self.end_bits) {
            if let Some(bytes) = left.get_mut(&Digest::from_content(stretch)) {
                let common = stretch.len().min(*bytes);
                *bytes -= common;
                shared += common;
            }
        }
        shared as f64 / self.bytes.max(object.len()).max(1) as f64
    }
}

fn stretches_of(bytes: &[u8], end_bits: u32) -> impl Iterator<Item = &[u8]> {
    let mut hash = 0_u32;
    let mut ends = move |byte: &u8| {
        // A step of a multiplicative hash: the bits that decide depend on the last bytes alone.
        hash = (hash << 1).wrapping_add(u32::from(*byte).wrapping_mul(0x9e37_79b1) >> 8);
        hash & ((1 << end_bits) - 1) == 0
    };
    bytes.split_inclusive(move |byte| ends(byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u32, bytes: u32) -> Vec<u8> {
        (0..bytes)
            .flat_map(|at| {
                Digest::from_content(&[seed.to_le_bytes(), at.to_le_bytes()].concat()).as_bytes()[..1]
                    .to_vec()
            })
            .collect()
    }

    #[test]
    fn a_changed_byte_and_an_added_one_leave_most_of_a_file() {
        let object = noise(1, 20_000);
        let mut flipped = object.clone();
        flipped[777] ^= 4;
        let mut longer = object.clone();
        longer.splice(5_000..5_000, *b"words");
        assert_eq!(Outline::new(&object).share_with(&object), 1.0);
        for file in [flipped, longer, object[..19_000].to_vec()] {
            let share = Outline::new(&file).share_with(&object);
            assert!((0.9..1.0).contains(&share), "{share}");
        }
        let other = Outline::new(&noise(2, 20_000)).share_with(&object);
        assert!(other < 0.05, "{other}");
    }

    #[test]
    fn a_small_document_with_another_digit_is_known_again() {
        let object =
            br#"[{"psnr":18.32006166448675,"step":2,"rays":352,"samples":9211},{"psnr":18.5,"step":4}]"#;
        let mut file = object.to_vec();
        file[12] ^= 1;
        let share = Outline::new(&file).share_with(object);
        assert!((LEAST_SHARE..1.0).contains(&share), "{share}");
    }

    #[test]
    fn the_extremes_are_no_resemblance_and_no_panic() {
        let empty = Outline::new(b"");
        assert_eq!(empty.share_with(b""), 0.0);
        assert_eq!(empty.share_with(b"abc"), 0.0);
        assert!(!empty.may_resemble(1) && empty.may_resemble(0));
        let zeros = Outline::new(&[0; 1000]);
        assert_eq!(zeros.share_with(&[0; 1000]), 1.0);
        assert!(zeros.may_resemble(500) && !zeros.may_resemble(499) && !zeros.may_resemble(u64::MAX));
    }
}
