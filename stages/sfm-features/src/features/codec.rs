//! Features as bytes: magic, count, four little-endian floats for each keypoint, 128 bytes for each descriptor.

use super::keypoint::{Descriptor, Features, Keypoint};

const MAGIC: [u8; 8] = *b"marfSIF1";
const KEYPOINT_BYTES: usize = 16;

impl Features {
    /// Returns the features as bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend((self.keypoints.len() as u64).to_le_bytes());
        for point in &self.keypoints {
            let numbers = [point.x_px, point.y_px, point.scale_px, point.angle_rad];
            bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        }
        bytes.extend_from_slice(self.descriptors.as_flattened());
        bytes
    }

    /// Reads the bytes of [`Features::encode`]. `None` if a byte is missing or left over, or a number is not finite.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (count, rest) = bytes.strip_prefix(&MAGIC)?.split_first_chunk()?;
        let count = usize::try_from(u64::from_le_bytes(*count)).ok()?;
        let (keypoints, descriptors) = rest.split_at_checked(count.checked_mul(KEYPOINT_BYTES)?)?;
        let (descriptors, left) = descriptors.as_chunks::<{ size_of::<Descriptor>() }>();
        if descriptors.len() != count || !left.is_empty() {
            return None;
        }
        let keypoints: Option<Vec<Keypoint>> = keypoints.chunks_exact(KEYPOINT_BYTES).map(keypoint).collect();
        Some(Self {
            keypoints: keypoints?,
            descriptors: descriptors.to_vec(),
        })
    }
}

/// Reads one keypoint.
fn keypoint(bytes: &[u8]) -> Option<Keypoint> {
    let mut numbers = bytes.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes));
    let mut next = || numbers.next().filter(|number| number.is_finite());
    Some(Keypoint {
        x_px: next()?,
        y_px: next()?,
        scale_px: next()?,
        angle_rad: next()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> Features {
        let keypoint = |index: u8| Keypoint {
            x_px: f32::from(index) + 0.25,
            y_px: -0.0,
            scale_px: f32::MAX,
            angle_rad: 6.0,
        };
        Features {
            keypoints: (0..3).map(keypoint).collect(),
            descriptors: (0..3).map(|index| [index; 128]).collect(),
        }
    }

    #[test]
    fn bytes_come_back_as_they_went() {
        for features in [some(), Features::default()] {
            assert_eq!(Features::decode(&features.encode()), Some(features));
        }
        assert_eq!(some().encode().len(), 16 + 3 * (16 + 128));
    }

    #[test]
    fn what_is_cut_or_too_long_or_not_finite_is_refused() {
        let bytes = some().encode();
        for len in 0..bytes.len() {
            assert_eq!(Features::decode(&bytes[..len]), None, "{len}");
        }
        assert_eq!(Features::decode(&[bytes.clone(), vec![0]].concat()), None);
        let with = |at: usize, new: &[u8]| {
            let mut bytes = bytes.clone();
            bytes[at..at + new.len()].copy_from_slice(new);
            Features::decode(&bytes)
        };
        for count in [0, 2, 4, u64::MAX, u64::MAX / 16 + 2] {
            assert_eq!(with(8, &count.to_le_bytes()), None, "{count}");
        }
        for number in [f32::NAN, f32::INFINITY] {
            assert_eq!(with(20, &number.to_le_bytes()), None, "{number}");
        }
        assert_eq!(with(0, b"x"), None);
    }
}
