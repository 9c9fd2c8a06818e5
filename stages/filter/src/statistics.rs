//! Statistics over the photos of one instrument.

use std::collections::BTreeMap;

use crate::filter::MeasuredPhoto;

/// Returns the indices of the photos of each instrument: photos of different cameras are not compared.
pub(crate) fn group_by_instrument<M>(photos: &[MeasuredPhoto<'_, M>]) -> Vec<Vec<usize>> {
    let mut groups = BTreeMap::<_, Vec<usize>>::new();
    for (index, photo) in photos.iter().enumerate() {
        groups.entry(photo.facts.instrument).or_default().push(index);
    }
    groups.into_values().collect()
}

/// Values in ascending order, for quantiles that leave one of them out.
pub(crate) struct SortedValues(Vec<f64>);

impl SortedValues {
    /// Sorts the values; none may be NaN.
    pub(crate) fn new(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        Self(values)
    }

    /// Returns the quantile `numerator / denominator` of all values but one equal to `left_out`, linear between
    /// neighbours; 0 if none is left.
    pub(crate) fn quantile_without(&self, left_out: f64, numerator: usize, denominator: usize) -> f64 {
        let gap = self.0.partition_point(|value| *value < left_out);
        let last = match self.0.len() {
            0 | 1 => return 0.0,
            len => len - 2,
        };
        let at = |index: usize| self.0[if index < gap { index } else { index + 1 }];
        let (whole, part) = (last * numerator / denominator, last * numerator % denominator);
        if part == 0 {
            return at(whole);
        }
        at(whole) + (at(whole + 1) - at(whole)) * (part as f64 / denominator as f64)
    }
}

/// The values around the median, for medians that leave one value out; found in linear time.
pub(crate) struct MiddleValues {
    /// The values from the median of all but one on, as far as there are.
    middle: [f64; 3],
    count: usize,
}

impl MiddleValues {
    /// Finds them; none may be NaN. Puts the values in another order.
    pub(crate) fn of(values: &mut [f64]) -> Self {
        let count = values.len();
        let mut middle = [0.0; 3];
        if count >= 2 {
            let (_, first, above) = values.select_nth_unstable_by((count - 2) / 2, f64::total_cmp);
            middle[0] = *first;
            // The two smallest of the values above.
            let (mut second, mut third) = (f64::INFINITY, f64::INFINITY);
            for value in above {
                third = third.min(second.max(*value));
                second = second.min(*value);
            }
            (middle[1], middle[2]) = (second, third);
        }
        Self { middle, count }
    }

    /// Returns the median of all values but one equal to `left_out`; 0 if none is left. Equal to
    /// [`SortedValues::quantile_without`] of 1 / 2.
    pub(crate) fn median_without(&self, left_out: f64) -> f64 {
        if self.count < 2 {
            return 0.0;
        }
        // The value left out is no later than index i exactly if the value there is not smaller.
        let at = |index: usize| {
            self.middle[if self.middle[index] < left_out {
                index
            } else {
                index + 1
            }]
        };
        if (self.count - 2).is_multiple_of(2) {
            return at(0);
        }
        at(0) + (at(1) - at(0)) * 0.5
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn medians_are_those_of_the_sorted_values(steps in proptest::collection::vec(0_u8..6, 0..12), other in 0_u8..6) {
            let values: Vec<f64> = steps.iter().map(|step| f64::from(*step) / 3.0).collect();
            let (sorted, middle) = (SortedValues::new(values.clone()), MiddleValues::of(&mut values.clone()));
            for left_out in values.iter().copied().chain([f64::from(other) / 3.0]) {
                if values.contains(&left_out) {
                    prop_assert_eq!(sorted.quantile_without(left_out, 1, 2), middle.median_without(left_out));
                }
            }
        }
    }

    #[test]
    fn a_value_left_out_does_not_move_the_median() {
        let ranked = SortedValues::new(vec![5.0, 1.0, 2.0, 100.0, 3.0]);
        assert_eq!(ranked.quantile_without(100.0, 1, 2), 2.5);
        assert_eq!(ranked.quantile_without(1.0, 1, 2), 4.0);
        assert_eq!(ranked.quantile_without(3.0, 3, 4), 28.75);
    }

    #[test]
    fn one_value_has_no_others() {
        assert_eq!(SortedValues::new(vec![7.0]).quantile_without(7.0, 1, 2), 0.0);
        assert_eq!(SortedValues::new(vec![]).quantile_without(7.0, 1, 2), 0.0);
        assert_eq!(SortedValues::new(vec![7.0, 8.0]).quantile_without(7.0, 1, 2), 8.0);
    }
}
