use std::hash::{BuildHasher as _, Hasher as _, RandomState};

use crate::Digest;

/// Which blobs a check reads: none, all, or a share of them. Each check takes another sample.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReadShare {
    /// So many of 2³² digests.
    parts: u64,
    /// Where in the ring of digests the sample starts.
    start: u32,
}

impl ReadShare {
    /// No blob is read.
    pub const NONE: Self = Self { parts: 0, start: 0 };
    /// All blobs are read.
    pub const ALL: Self = Self {
        parts: 1 << 32,
        start: 0,
    };

    /// Returns a random sample of a share of the blobs, in [0, 1].
    pub fn sample(share: f64) -> Self {
        Self {
            parts: (share.clamp(0.0, 1.0) * 4_294_967_296.0).round() as u64,
            start: RandomState::new().build_hasher().finish() as u32,
        }
    }

    /// Returns whether the check reads this blob, or this pack of blobs.
    pub fn has(self, digest: &Digest) -> bool {
        let [a, b, c, d, ..] = *digest.as_bytes();
        let place = u32::from_le_bytes([a, b, c, d]);
        u64::from(place.wrapping_sub(self.start)) < self.parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_has_its_share_and_each_is_another() {
        let digests: Vec<Digest> = (0..10_000_u32)
            .map(|number| Digest::from_content(&number.to_le_bytes()))
            .collect();
        let chosen = |share: ReadShare| -> Vec<&Digest> {
            digests.iter().filter(|digest| share.has(digest)).collect()
        };
        assert!(chosen(ReadShare::NONE).is_empty() && chosen(ReadShare::sample(0.0)).is_empty());
        assert_eq!(chosen(ReadShare::ALL).len(), 10_000);
        assert_eq!(chosen(ReadShare::sample(1.0)).len(), 10_000);
        let samples = [0; 8].map(|_| chosen(ReadShare::sample(0.05)));
        for sample in &samples {
            // The standard deviation is 22.
            assert!((390..=610).contains(&sample.len()), "{}", sample.len());
        }
        assert!(samples.iter().any(|sample| *sample != samples[0]));
    }
}
