//! Statistics over the photos of one instrument.

use std::collections::BTreeMap;

use crate::filter::MeasuredPhoto;

/// Returns the indices of the photos of each instrument: photos of different cameras are not compared.
pub(crate) fn group_by_instrument<M>(photos: &[MeasuredPhoto<M>]) -> Vec<Vec<usize>> {
    let mut groups = BTreeMap::<_, Vec<usize>>::new();
    for (index, photo) in photos.iter().enumerate() {
        groups
            .entry(photo.facts.instrument.as_deref())
            .or_default()
            .push(index);
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

#[cfg(test)]
mod tests {
    use super::*;

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
