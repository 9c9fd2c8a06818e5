/// Odd part of 2^64 / golden ratio: the increment of SplitMix64.
pub const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Mixes 64 bits so that every bit depends on all of them; a bijection (the finaliser of SplitMix64).
#[inline]
pub const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A stream of random numbers: SplitMix64 (Steele, Lea and Flood, OOPSLA 2014). All 64 bits of the seed count.
#[derive(Debug, Clone)]
pub struct Rng(u64);

impl Rng {
    /// Returns the stream of a seed. Streams of nearby seeds overlap unless the seeds were mixed ([`mix`]).
    #[inline]
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns the next 64 bits.
    #[inline]
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(GOLDEN);
        mix(self.0)
    }

    /// Returns a number in [0, 1), a multiple of 2^-24.
    #[inline]
    pub fn unit_f32(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / 16_777_216.0
    }

    /// Returns a number in [0, 1), a multiple of 2^-53.
    #[inline]
    pub fn unit_f64(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Returns an integer in [0, bound); 0 if `bound` is 0. The bias is below bound / 2^64.
    #[inline]
    pub fn below(&mut self, bound: u64) -> u64 {
        ((u128::from(self.bits()) * u128::from(bound)) >> 64) as u64
    }

    /// Returns `N` different numbers of [0, count), in the order drawn.
    ///
    /// # Panics
    /// If `count` is below `N`: so many different numbers do not exist.
    pub fn sample<const N: usize>(&mut self, count: usize) -> [usize; N] {
        assert!(count >= N, "{N} different numbers out of {count}");
        let mut drawn = [usize::MAX; N];
        for slot in 0..N {
            let mut candidate = self.below(count as u64) as usize;
            while drawn[..slot].contains(&candidate) {
                candidate = self.below(count as u64) as usize;
            }
            drawn[slot] = candidate;
        }
        drawn
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_numbers_are_those_of_the_reference() {
        let mut rng = Rng::new(0);
        assert_eq!(rng.bits(), 0xe220_a839_7b1d_cdaf);
        assert_eq!(rng.bits(), 0x6e78_9e6a_a1b9_65f4);
    }

    #[test]
    fn every_bit_of_the_seed_changes_the_first_number() {
        let first = |seed: u64| Rng::new(seed).bits();
        for bit in 0..64 {
            assert_ne!(first(0), first(1 << bit), "bit {bit}");
        }
    }

    #[test]
    fn numbers_of_the_unit_interval_stay_below_one_and_average_one_half() {
        let mut rng = Rng::new(7);
        let (mut sum_f32, mut sum_f64) = (0.0, 0.0);
        for _ in 0..100_000 {
            let (x, y) = (rng.unit_f32(), rng.unit_f64());
            assert!((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y), "{x} {y}");
            sum_f32 += f64::from(x);
            sum_f64 += y;
        }
        // The mean of 1e5 uniform numbers has a standard deviation of 0.0009.
        for mean in [sum_f32 / 1e5, sum_f64 / 1e5] {
            assert!((mean - 0.5).abs() < 0.005, "{mean}");
        }
    }

    #[test]
    fn integers_below_a_bound_reach_both_ends_and_no_further() {
        let mut rng = Rng::new(7);
        let mut hits = [0; 3];
        for _ in 0..300 {
            hits[rng.below(3) as usize] += 1;
        }
        assert!(hits.iter().all(|&hits| hits > 60), "{hits:?}");
        assert_eq!(rng.below(0), 0);
        assert!(rng.below(u64::MAX) < u64::MAX);
    }

    #[test]
    fn a_sample_has_no_number_twice_and_uses_the_whole_range() {
        let mut rng = Rng::new(7);
        let mut hits = [0; 6];
        for _ in 0..600 {
            let mut drawn = rng.sample::<5>(6);
            drawn.iter().for_each(|&index| hits[index] += 1);
            drawn.sort_unstable();
            assert!(drawn.windows(2).all(|pair| pair[0] < pair[1]), "{drawn:?}");
        }
        assert!(hits.iter().all(|&count| (450..=550).contains(&count)), "{hits:?}");
    }

    #[test]
    #[should_panic(expected = "5 different numbers out of 4")]
    fn a_sample_larger_than_its_range_is_refused() {
        Rng::new(0).sample::<5>(4);
    }
}
