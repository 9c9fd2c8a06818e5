//! Seeded dice: the same numbers on every machine.

/// SplitMix64 (Steele, Lea, Flood 2014): all 64 bits of the seed count.
#[derive(Debug, Clone)]
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The next 64 bits.
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number in 0..bound (0 for an empty range), by the high half of a wide product.
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.next()) * bound as u128) >> 64) as usize
    }

    /// A number in [0, 1) with 53 bits.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// `N` different numbers of 0..count, in the order drawn; `count` is at least `N`.
    pub(crate) fn sample<const N: usize>(&mut self, count: usize) -> [usize; N] {
        let mut drawn = [usize::MAX; N];
        for slot in 0..N {
            let mut candidate = self.below(count);
            while drawn[..slot].contains(&candidate) {
                candidate = self.below(count);
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
    fn a_sample_has_no_number_twice_and_uses_the_whole_range() {
        let mut dice = Dice::new(7);
        let mut seen = [0; 6];
        for _ in 0..600 {
            let mut drawn = dice.sample::<5>(6);
            drawn.iter().for_each(|&index| seen[index] += 1);
            drawn.sort_unstable();
            assert!(drawn.windows(2).all(|pair| pair[0] < pair[1]), "{drawn:?}");
        }
        assert!(seen.iter().all(|&count| (450..=550).contains(&count)), "{seen:?}");
    }

    #[test]
    fn the_first_numbers_are_those_of_the_paper() {
        // SplitMix64 from 0: the published reference sequence.
        let mut dice = Dice::new(0);
        assert_eq!(dice.next(), 0xe220_a839_7b1d_cdaf);
        assert_eq!(dice.next(), 0x6e78_9e6a_a1b9_65f4);
    }
}
