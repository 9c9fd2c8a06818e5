//! Random numbers by counter: any thread can draw the numbers of any ray of any step.

use marf_numeric::{GOLDEN, mix};

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

/// A stream of random numbers that depends on all 64 bits of the seed.
#[derive(Clone, Debug)]
pub struct Rng(marf_numeric::Rng);

impl Rng {
    /// Returns the stream of (seed, purpose, step, index).
    pub fn new(seed: u64, purpose: Purpose, step: u64, index: u64) -> Self {
        let stream = mix(seed.wrapping_add(GOLDEN)).wrapping_add((purpose as u64).wrapping_mul(GOLDEN));
        let stream = mix(stream).wrapping_add(step.wrapping_mul(GOLDEN));
        // The last mix keeps neighbouring streams apart: draws advance by GOLDEN, too.
        let stream = mix(mix(stream).wrapping_add(index.wrapping_mul(GOLDEN)));
        Self(marf_numeric::Rng::new(stream))
    }

    /// Returns 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// Returns a number in [0, 1), a multiple of 2^-24.
    pub fn unit(&mut self) -> f32 {
        self.0.unit_f32()
    }

    /// Returns an integer in [0, n), 0 if n is 0. The bias is below n / 2^64.
    pub fn below(&mut self, n: u64) -> u64 {
        self.0.below(n)
    }
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
        let first = |seed: u64| Rng::new(seed, Purpose::Rays, 3, 4).bits();
        for bit in 0..64 {
            assert_ne!(first(0), first(1 << bit), "bit {bit}");
        }
    }

    #[test]
    fn unit_stays_below_one_and_its_mean_is_one_half() {
        let mut rng = Rng::new(7, Purpose::Rays, 0, 0);
        let numbers: Vec<f32> = (0..100_000).map(|_| rng.unit()).collect();
        assert!(numbers.iter().all(|x| (0.0..1.0).contains(x)));
        let mean = numbers.iter().sum::<f32>() / 1e5;
        // The mean of 1e5 uniform numbers has a standard deviation of 0.0009.
        assert!((mean - 0.5).abs() < 0.005, "{mean}");
    }

    #[test]
    fn below_reaches_both_ends_and_no_further() {
        let mut rng = Rng::new(7, Purpose::Rays, 0, 1);
        let mut hits = [0; 3];
        for _ in 0..300 {
            hits[rng.below(3) as usize] += 1;
        }
        assert!(hits.iter().all(|&hits| hits > 60), "{hits:?}");
        assert_eq!(rng.below(0), 0);
    }
}
