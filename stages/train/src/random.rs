use marf_cache::{ContentHash, digest_of};

/// Returns 64 random bits: the first of the content hash of `seed`, little endian.
pub(crate) fn random_u64(seed: &impl ContentHash) -> u64 {
    let digest = digest_of(seed);
    let bytes = digest.as_bytes().iter().take(8).rev();
    bytes.fold(0, |value, byte| value << 8 | u64::from(*byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_byte_of_the_digest_is_the_lowest() {
        let seed = ("key", 7_u64);
        let digest = digest_of(&seed);
        let low = random_u64(&seed).to_le_bytes();
        assert_eq!(low, digest.as_bytes()[..8]);
    }
}
