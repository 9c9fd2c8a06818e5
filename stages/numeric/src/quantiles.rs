//! Medians and quantiles: always one of the values, never a mean of two, so that the result does not depend on rounding.
//!
//! Values are ordered by [`f64::total_cmp`]: -NaN, -∞, …, -0, +0, …, ∞, NaN. Equal values have equal bits, so that the order in
//! which the values come never shows. All functions take O(n) time and return `None` of no values.

/// Returns the median, the larger of the two middle values if the number of values is even.
pub fn upper_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    at_rank(values, middle)
}

/// Returns the median, the smaller of the two middle values if the number of values is even.
pub fn lower_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.into_iter().collect();
    let middle = values.len().saturating_sub(1) / 2;
    at_rank(values, middle)
}

/// Returns the value of rank ⌊n · `share`⌋, counted from 0, or the largest value if there is no such rank.
///
/// - `share`: in [0, 1]. At 0.5 this is [`upper_median`].
pub fn quantile(values: impl IntoIterator<Item = f64>, share: f64) -> Option<f64> {
    let values: Vec<f64> = values.into_iter().collect();
    let rank = ((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1));
    at_rank(values, rank)
}

/// Returns the value that `rank` values come before.
fn at_rank(mut values: Vec<f64>, rank: usize) -> Option<f64> {
    (rank < values.len()).then(|| *values.select_nth_unstable_by(rank, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    #[test]
    fn an_odd_number_of_values_has_one_median() {
        assert_eq!(upper_median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(lower_median([3.0, 1.0, 2.0]), Some(2.0));
    }

    #[test]
    fn an_even_number_of_values_has_an_upper_and_a_lower_median() {
        assert_eq!(upper_median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(lower_median([4.0, 1.0, 3.0, 2.0]), Some(2.0));
    }

    #[test]
    fn quantiles_are_values_at_ranks() {
        let values = [50.0, 10.0, 40.0, 20.0, 30.0];
        let at = |share| quantile(values, share);
        assert_eq!(
            [0.0, 0.19, 0.2, 0.8, 1.0].map(at),
            [10.0, 10.0, 20.0, 50.0, 50.0].map(Some)
        );
    }

    #[test]
    fn no_values_have_no_median_and_no_quantile() {
        assert_eq!(upper_median([]), None);
        assert_eq!(lower_median([]), None);
        assert_eq!(quantile([], 0.5), None);
    }

    #[test]
    fn values_that_are_not_a_number_are_ordered_too() {
        let values = [f64::NAN, f64::NEG_INFINITY, -0.0, 0.0, f64::INFINITY];
        assert_eq!(upper_median(values).map(f64::to_bits), Some(0.0_f64.to_bits()));
        assert!(quantile(values, 1.0).is_some_and(f64::is_nan));
    }

    #[test]
    fn the_values_are_those_of_a_sorted_list() {
        let mut random = Rng::new(7);
        for count in 1..200 {
            let values: Vec<f64> = (0..count).map(|_| random.below(50) as f64).collect();
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let iter = || values.iter().copied();
            assert_eq!(upper_median(iter()), Some(sorted[count / 2]), "{values:?}");
            assert_eq!(lower_median(iter()), Some(sorted[(count - 1) / 2]), "{values:?}");
            assert_eq!(quantile(iter(), 0.5), upper_median(iter()), "{values:?}");
            let last = sorted.get((count as f64 * 0.8) as usize).copied();
            assert_eq!(quantile(iter(), 0.8), last, "{values:?}");
        }
    }
}
