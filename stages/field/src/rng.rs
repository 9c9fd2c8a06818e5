//! Random numbers by counter: any thread can draw the numbers of any ray of any step.

use marf_numeric::{GOLDEN, Rng, mix};

/// What the numbers are for. Each purpose has its own stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Start values of the tables.
    Tables = 1,
    /// Start values of the networks.
    Networks = 2,
    /// Pixels and jitter of a step.
    Rays = 3,
    /// Points of the occupancy grid.
    Occupancy = 4,
    /// Pixels of a photo that are kept.
    Thinning = 8,
}

/// Returns the random numbers of (seed, purpose, step, index). They depend on all 64 bits of the seed.
pub fn random_numbers(seed: u64, purpose: Purpose, step: u64, index: u64) -> Rng {
    let stream = mix(seed.wrapping_add(GOLDEN)).wrapping_add((purpose as u64).wrapping_mul(GOLDEN));
    let stream = mix(stream).wrapping_add(step.wrapping_mul(GOLDEN));
    // The last mix keeps neighbouring streams apart: draws advance by GOLDEN, too.
    Rng::new(mix(mix(stream).wrapping_add(index.wrapping_mul(GOLDEN))))
}

/// A 64-bit digest of numbers in order, to find mistakes. It does not protect against forgery.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fingerprint(pub u64);

impl Fingerprint {
    /// Adds more numbers.
    pub fn add(&mut self, numbers: impl IntoIterator<Item = u64>) {
        for number in numbers {
            self.0 = mix(self.0.wrapping_add(GOLDEN) ^ mix(number));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_the_seed_changes_the_stream() {
        let first = |seed: u64| random_numbers(seed, Purpose::Rays, 3, 4).bits();
        for bit in 0..64 {
            assert_ne!(first(0), first(1 << bit), "bit {bit}");
        }
    }
}
