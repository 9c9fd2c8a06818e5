//! Distributions of values as counts in bins, which merge exactly in any order, and their quantiles.

use serde::{Deserialize, Serialize};

/// Bins of equal width in the logarithm, nearly: those of numbers of equal exponent and equal first bits of the mantissa. A
/// bin is found without a logarithm, whose last bit would differ from machine to machine.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LogBins {
    /// Bits of the mantissa, at most 20: of `n` bits a bin is between 2^-(n+1) and 2^-n of its values wide.
    pub(crate) bits: u32,
}

impl LogBins {
    /// Returns the bin of a value. A value below 0 counts as 0, an infinite one as the largest. `None` for NaN.
    pub(crate) fn bin(self, value: f64) -> Option<u32> {
        let bits = value.clamp(0.0, f64::MAX).to_bits() & !(1 << 63);
        (!value.is_nan()).then_some((bits >> (f64::MANTISSA_DIGITS - 1 - self.bits)) as u32)
    }

    /// Returns the value in the middle of a bin. 0 for the first.
    pub(crate) fn middle(self, bin: u32) -> f64 {
        let dropped = f64::MANTISSA_DIGITS - 1 - self.bits;
        match bin {
            0 => 0.0,
            bin => f64::from_bits((u64::from(bin) << dropped) | 1 << (dropped - 1)),
        }
    }
}

/// The bins that have values, ascending, each with their number. A list, since there are far fewer bins than values: once all are
/// known, adding the bins of more photos moves nothing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct BinCounts(Vec<(u32, u32)>);

impl BinCounts {
    /// Counts values by their bins.
    pub(crate) fn new(bins: impl Iterator<Item = u32>) -> Self {
        let mut bins: Vec<u32> = bins.collect();
        bins.sort_unstable();
        let runs = bins.chunk_by(|a, b| a == b);
        Self(runs.map(|run| (run[0], run.len() as u32)).collect())
    }

    /// Adds others. `None` if they are more than can be counted.
    pub(crate) fn add(&mut self, others: &Self) -> Option<()> {
        for (bin, count) in &others.0 {
            match self.0.binary_search_by_key(bin, |(bin, _)| *bin) {
                Ok(at) => self.0[at].1 = self.0[at].1.checked_add(*count)?,
                Err(at) => self.0.insert(at, (*bin, *count)),
            }
        }
        Some(())
    }

    /// Returns the bins that have values, ascending, each with their number.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (u32, u64)> + Clone {
        self.0.iter().map(|(bin, count)| (*bin, u64::from(*count)))
    }

    /// Returns a quantile as [`quantile_without`] does.
    pub(crate) fn quantile_without(&self, quantile: Quantile, scale: LogBins) -> Steps {
        quantile_without(self.iter(), quantile, |bin| scale.middle(bin))
    }
}

/// A quantile as a fraction, at most 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Quantile {
    numerator: u64,
    denominator: u64,
}

impl Quantile {
    /// Half of the values are smaller.
    pub(crate) const MEDIAN: Self = Self {
        numerator: 1,
        denominator: 2,
    };
    /// Three quarters of the values are smaller.
    pub(crate) const UPPER_QUARTILE: Self = Self {
        numerator: 3,
        denominator: 4,
    };
}

/// Returns a quantile of all values but one, for each bin that this one may be in: linear between neighbours, 0 if no
/// value remains. `bins` ascend, each with the number of its values. `value` is that of a bin.
pub(crate) fn quantile_without(
    bins: impl Iterator<Item = (u32, u64)> + Clone,
    quantile: Quantile,
    value: impl Fn(u32) -> f64,
) -> Steps {
    let Quantile {
        numerator,
        denominator,
    } = quantile;
    let count: u64 = bins.clone().map(|(_, count)| count).sum();
    let Some(last) = count.checked_sub(2) else {
        return Steps::constant(0.0);
    };
    let (rank, part) = (last * numerator / denominator, last * numerator % denominator);
    // The value left out decides which two of three neighbours the quantile is between.
    let [low, middle, high] = at_ranks(bins, [rank, rank + 1, (rank + 2).min(count - 1)]);
    let between = |low: u32, high: u32| {
        let (low, high) = (value(low), value(high));
        low + (high - low) * (part as f64 / denominator as f64)
    };
    let without_lower = between(middle, high);
    let without_low_to_middle = between(low, high);
    let without_higher = between(low, middle);
    Steps::new(
        [without_lower, without_low_to_middle, without_higher],
        [low + 1, middle + 1],
    )
}

/// Returns the bins of the values at three ascending ranks, counted from 0. Each rank is below the number of values.
fn at_ranks(bins: impl Iterator<Item = (u32, u64)>, ranks: [u64; 3]) -> [u32; 3] {
    let (mut found, mut next, mut below) = ([0; 3], 0, 0);
    for (bin, count) in bins {
        below += count;
        while next < ranks.len() && ranks[next] < below {
            found[next] = bin;
            next += 1;
        }
    }
    found
}

/// A number that depends on a bin: constant but for two steps at the most.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Steps {
    /// The values below the first step, from it on, from the second step on.
    values: [f64; 3],
    /// The bins of the steps. [`Steps::NEVER`] marks absent ones, which change no value.
    from: [u32; 2],
}

impl Steps {
    /// A bin that no value is in.
    const NEVER: u32 = u32::MAX;

    /// Returns the number that is the same for all bins.
    pub(crate) fn constant(value: f64) -> Self {
        Self {
            values: [value; 3],
            from: [Self::NEVER; 2],
        }
    }

    /// Returns the number that has the second value from the first of two ascending bins on, and the third from the second bin on.
    fn new(values: [f64; 3], from: [u32; 2]) -> Self {
        let mut steps = Self::constant(values[0]);
        if from[0] < from[1] {
            steps.push(from[0], values[1]);
        }
        steps.push(from[1], values[2]);
        steps
    }

    /// Adds a step above all others. One that changes nothing is left out, so that equal numbers have equal parts.
    fn push(&mut self, from: u32, value: f64) {
        if value.to_bits() != self.values[2].to_bits() {
            let at = usize::from(self.from[0] != Self::NEVER);
            self.from[at] = from;
            self.values[at + 1..].fill(value);
        }
    }

    /// Returns the number of a bin. `None` is the highest bin.
    pub(crate) fn at(&self, bin: Option<u32>) -> f64 {
        let bin = bin.unwrap_or(Self::NEVER - 1);
        self.values[self.from.iter().filter(|from| bin >= **from).count()]
    }

    /// Returns a function of the number.
    pub(crate) fn map(&self, function: impl Fn(f64) -> f64) -> Self {
        Self::new(self.values.map(function), self.from)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::bytes::{from_bytes, to_bytes};

    const SCALE: LogBins = LogBins { bits: 6 };

    /// The quantile of all values but one, by sorting.
    fn expected(values: &[f64], left_out: usize, numerator: usize, denominator: usize) -> f64 {
        let mut others = values.to_vec();
        others.remove(left_out);
        others.sort_by(f64::total_cmp);
        let Some(last) = others.len().checked_sub(1) else {
            return 0.0;
        };
        let (whole, part) = (last * numerator / denominator, last * numerator % denominator);
        if part == 0 {
            return others[whole];
        }
        others[whole] + (others[whole + 1] - others[whole]) * (part as f64 / denominator as f64)
    }

    fn counts(parts: &[Vec<u32>]) -> BinCounts {
        let mut counts = BinCounts::default();
        for bins in parts {
            counts.add(&BinCounts::new(bins.iter().copied())).unwrap();
        }
        counts
    }

    proptest! {
        #[test]
        fn quantiles_of_bins_are_those_of_the_sorted_middles_whatever_the_parts(
            parts in prop::collection::vec(prop::collection::vec(0_u32..7, 0..6), 0..4),
        ) {
            let (counts, bins) = (counts(&parts), parts.concat());
            let values: Vec<f64> = bins.iter().map(|bin| SCALE.middle(1000 + bin)).collect();
            let shifted: Vec<Vec<u32>> = vec![bins.iter().map(|bin| 1000 + bin).collect()];
            for (quantile, numerator, denominator) in [(Quantile::MEDIAN, 1, 2), (Quantile::UPPER_QUARTILE, 3, 4)] {
                let steps = quantile_without(
                    counts.iter(), quantile, |bin| SCALE.middle(1000 + bin));
                let moved = super::tests::counts(&shifted).quantile_without(quantile, SCALE);
                for (at, bin) in bins.iter().enumerate() {
                    let found = steps.at(Some(*bin));
                    prop_assert_eq!(found, expected(&values, at, numerator, denominator), "{} of {:?}", bin, bins);
                    prop_assert_eq!(found, moved.at(Some(1000 + bin)));
                }
            }
        }

        #[test]
        fn bins_are_narrow_ascend_and_hold_their_middle(value in 1e-300_f64..1e300, other in 1e-300_f64..1e300) {
            let bin = SCALE.bin(value).unwrap();
            let middle = SCALE.middle(bin);
            prop_assert_eq!(SCALE.bin(middle), Some(bin));
            prop_assert!((value / middle - 1.0).abs() <= 1.0 / 128.0, "{value} in {middle}");
            prop_assert_eq!(value < other && SCALE.bin(value) > SCALE.bin(other), false);
        }

        #[test]
        fn steps_survive_their_bytes_and_are_equal_where_all_values_are(
            pieces in (0_u8..3, 0_u32..9, 0_u8..3, 0_u32..9, 0_u8..3),
        ) {
            let (first, from, second, later, third) = pieces;
            let steps = Steps::new([first, second, third].map(f64::from), [from, from + later]);
            for bin in 0..20 {
                let expected = if bin < from { first } else if bin < from + later { second } else { third };
                prop_assert_eq!(steps.at(Some(bin)), f64::from(expected));
            }
            prop_assert_eq!(steps.at(None), f64::from(third));
            let bytes = to_bytes(&steps).unwrap();
            prop_assert_eq!(from_bytes(&bytes), Some(steps));
            prop_assert_eq!(from_bytes::<Steps>(&bytes[..bytes.len() - 1]), None);
            let same = steps.map(|_| 5.0);
            prop_assert_eq!(same, Steps::constant(5.0));
        }
    }

    /// By hand, from the bits: 1 has exponent 1023 and no mantissa, 1.5 its first bit, 3.99 all bits of the exponent 1024.
    #[test]
    fn bins_are_those_of_the_first_bits() {
        assert_eq!(SCALE.bin(1.0), Some(1023 << 6));
        assert_eq!(SCALE.bin(1.5), Some((1023 << 6) + 32));
        assert_eq!(SCALE.bin(3.99), Some((1024 << 6) + 63));
        assert_eq!(SCALE.middle(1023 << 6), 1.0 + 1.0 / 128.0);
    }

    #[test]
    fn values_at_the_extremes_have_a_bin_of_a_finite_middle_and_what_is_no_number_has_none() {
        for zero in [0.0, -0.0, -3.0, f64::NEG_INFINITY, f64::from_bits(1)] {
            assert_eq!(SCALE.bin(zero), Some(0), "{zero}");
        }
        assert_eq!(SCALE.middle(0), 0.0);
        for large in [f64::MAX, f64::INFINITY] {
            let bin = SCALE.bin(large).unwrap();
            assert!(
                SCALE.middle(bin).is_finite() && SCALE.middle(bin) > 1e308,
                "{bin}"
            );
        }
        assert_eq!(SCALE.bin(f64::NAN), None);
        assert_eq!(SCALE.bin(-f64::NAN), None);
    }

    /// The values 1, 2, 3, 5 and 100: without 100 the median is 2.5, without 1 it is 4, and without 3 the upper quartile is
    /// 28.75.
    #[test]
    fn the_value_left_out_does_not_move_the_median() {
        let bins = [(1, 1), (2, 1), (3, 1), (5, 1), (100, 1)].into_iter();
        let median = quantile_without(bins.clone(), Quantile::MEDIAN, f64::from);
        assert_eq!((median.at(Some(100)), median.at(Some(1))), (2.5, 4.0));
        let quartile = quantile_without(bins, Quantile::UPPER_QUARTILE, f64::from);
        assert_eq!(quartile.at(Some(3)), 28.75);
    }

    #[test]
    fn one_value_has_no_others_and_a_million_equal_ones_have_no_steps() {
        let of = |bins: &[(u32, u64)]| quantile_without(bins.iter().copied(), Quantile::MEDIAN, f64::from);
        assert_eq!(of(&[]), Steps::constant(0.0));
        assert_eq!(of(&[(7, 1)]), Steps::constant(0.0));
        assert_eq!(
            (
                of(&[(7, 1), (8, 1)]).at(Some(7)),
                of(&[(7, 1), (8, 1)]).at(Some(8))
            ),
            (8.0, 7.0)
        );
        assert_eq!(of(&[(7, 1_000_000)]), Steps::constant(7.0));
        assert_eq!(of(&[(7, u64::from(u32::MAX) * 4)]), Steps::constant(7.0));
    }

    #[test]
    fn bins_are_counted_and_more_than_can_be_counted_are_refused() {
        let mut counts = counts(&[vec![300, 7, 300], vec![], vec![8, 300]]);
        assert_eq!(counts.0, [(7, 1), (8, 1), (300, 3)]);
        let bytes = to_bytes(&counts).unwrap();
        assert_eq!(bytes, [3, 7, 1, 8, 1, 0xac, 2, 3]);
        for cut in 0..bytes.len() {
            assert_eq!(from_bytes::<BinCounts>(&bytes[..cut]), None, "cut at {cut}");
        }
        assert_eq!(counts.add(&BinCounts(vec![(300, u32::MAX)])), None);
    }
}
