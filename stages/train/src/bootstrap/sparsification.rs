/// How errors of the pixels that are kept are averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Norm {
    /// Mean absolute error.
    Mae,
    /// Root of the mean squared error.
    Rmse,
}

/// Curves of the error that is left, and areas between that and the one of the best order, over the larger of their maxima.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sparsification {
    /// Error of the pixels that are left after each share is removed.
    pub curve: Vec<f64>,
    /// The same in the best order.
    pub best: Vec<f64>,
    /// Pixels are removed by their uncertainty: 0 is a perfect order.
    pub ause: f64,
    /// Of a random order, whose curve is level at the mean error on average.
    pub ause_random: f64,
}

/// Returns the shares that are removed: 0, 0.01, .. 0.99.
pub(crate) fn hundredths() -> Vec<f64> {
    (0..100).map(|share| f64::from(share) / 100.0).collect()
}

/// Returns the areas for pixels removed step by step, the most uncertain first (as `bayesrays/metrics/ause.py` does).
///
/// `uncertainty`, `error`: one value a pixel, errors not negative. `removed`: shares in [0, 1), rising. Of N pixels ⌊(1 - r) N + 0.5⌋ are
/// kept, at least one. Ties keep the order of the pixels.
/// Extremes: without an error anywhere the area is 0.
pub(crate) fn sparsify(uncertainty: &[f32], error: &[f32], removed: &[f64], norm: Norm) -> Sparsification {
    let curve = left(uncertainty, error, removed, norm);
    let best = left(error, error, removed, norm);
    let random = vec![curve.first().copied().unwrap_or(0.0); removed.len()];
    Sparsification {
        ause: area(&curve, &best, removed),
        ause_random: area(&random, &best, removed),
        curve,
        best,
    }
}

/// Returns the mean error of the pixels left after each share is removed.
fn left(order_by: &[f32], error: &[f32], removed: &[f64], norm: Norm) -> Vec<f64> {
    let mut order: Vec<usize> = (0..error.len()).collect();
    order.sort_by(|a, b| order_by[*a].total_cmp(&order_by[*b]).then(a.cmp(b)));
    let mut sums = vec![0.0];
    let mut sum = 0.0;
    for pixel in order {
        let error = f64::from(error[pixel]);
        sum += match norm {
            Norm::Mae => error,
            Norm::Rmse => error * error,
        };
        sums.push(sum);
    }
    let mean_left = |share: &f64| {
        let kept = ((1.0 - share) * error.len() as f64 + 0.5) as usize;
        let kept = kept.clamp(1, error.len().max(1));
        let mean = sums.get(kept).copied().unwrap_or(0.0) / kept as f64;
        match norm {
            Norm::Mae => mean,
            Norm::Rmse => mean.sqrt(),
        }
    };
    removed.iter().map(mean_left).collect()
}

/// Returns the area between two curves, by trapezoids, over the larger of their maxima.
fn area(curve: &[f64], oracle: &[f64], removed: &[f64]) -> f64 {
    let largest = curve.iter().chain(oracle).copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return 0.0;
    }
    let gap = |index: usize| (curve[index] - oracle[index]) / largest;
    let strips = (1..removed.len())
        .map(|index| (gap(index) + gap(index - 1)) / 2.0 * (removed[index] - removed[index - 1]));
    strips.sum()
}

/// Returns the correlation of two lists, in [-1, 1], or 0 if one of them is constant.
pub(crate) fn pearson(a: &[f64], b: &[f64]) -> f64 {
    let count = a.len().max(1) as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / count, b.iter().sum::<f64>() / count);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        ab += (a - mean_a) * (b - mean_b);
        aa += (a - mean_a) * (a - mean_a);
        bb += (b - mean_b) * (b - mean_b);
    }
    if aa > 0.0 && bb > 0.0 {
        ab / (aa * bb).sqrt()
    } else {
        0.0
    }
}

/// Returns the correlation of the ranks of two lists, in [-1, 1]. Equal values share their mean rank.
pub(crate) fn spearman(a: &[f32], b: &[f32]) -> f64 {
    pearson(&ranks(a), &ranks(b))
}

/// Returns the rank of every value, from 0. Equal values share their mean rank.
fn ranks(values: &[f32]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut place = 0;
    for tied in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let rank = place as f64 + (tied.len() - 1) as f64 / 2.0;
        tied.iter().for_each(|index| ranks[*index] = rank);
        place += tied.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::super::maps::tests::close;
    use super::*;

    const STD: [f32; 4] = [0.016_330, 0.048_990, 0.040_825, 0.020_000];
    const ERROR: [f32; 4] = [0.0, 0.10, 0.08, 0.19];
    const QUARTERS: [f64; 4] = [0.0, 0.25, 0.5, 0.75];

    #[test]
    fn the_worked_example_of_sparsification_comes_out() {
        let left = |order_by: &[f32]| super::left(order_by, &ERROR, &QUARTERS, Norm::Mae);
        for (found, expected) in left(&ERROR).into_iter().zip([0.0925, 0.06, 0.04, 0.0]) {
            close(found, expected, "by the error itself");
        }
        for (found, expected) in left(&STD).into_iter().zip([0.0925, 0.09, 0.095, 0.0]) {
            close(found, expected, "by std");
        }
        let found = sparsify(&STD, &ERROR, &QUARTERS, Norm::Mae);
        close(found.ause, 0.223684, "AUSE");
    }

    #[test]
    fn the_worked_example_of_correlation_comes_out() {
        close(spearman(&STD, &ERROR), 0.4, "Spearman");
        let wide = |values: [f32; 4]| values.map(f64::from);
        let found = pearson(&wide(STD), &wide(ERROR));
        assert!((found - 0.0798).abs() < 5e-5, "Pearson {found}");
    }

    #[test]
    fn an_order_by_the_error_is_perfect_and_half_an_order_lies_between_it_and_chance() {
        let error: Vec<f32> = (0..1000)
            .map(|pixel| (pixel * 37 % 1000) as f32 / 1000.0)
            .collect();
        let half = |(pixel, error): (usize, &f32)| error + (pixel * 59 % 1000) as f32 / 1000.0;
        let half: Vec<f32> = error.iter().enumerate().map(half).collect();
        for norm in [Norm::Mae, Norm::Rmse] {
            assert_eq!(
                sparsify(&error, &error, &hundredths(), norm).ause,
                0.0,
                "{norm:?}"
            );
            let found = sparsify(&half, &error, &hundredths(), norm);
            assert!(
                found.ause > 0.05 && found.ause < 0.7 * found.ause_random,
                "{norm:?}: {}",
                found.ause
            );
        }
    }

    #[test]
    fn ranks_agree_with_themselves_and_oppose_their_reverse() {
        let rising: Vec<f32> = (0..50).map(|step| step as f32).collect();
        let falling: Vec<f32> = rising.iter().map(|value| -value).collect();
        assert_eq!(spearman(&rising, &rising), 1.0);
        assert_eq!(spearman(&rising, &falling), -1.0);
    }

    #[test]
    fn extremes_give_zero_and_no_nan() {
        for (uncertainty, error) in [
            (vec![], vec![]),
            (vec![1.0; 5], vec![0.0; 5]),
            (vec![0.0], vec![3.0]),
        ] {
            let found = sparsify(&uncertainty, &error, &hundredths(), Norm::Rmse);
            assert_eq!((found.ause, found.ause_random), (0.0, 0.0), "{error:?}");
            assert_eq!(spearman(&uncertainty, &error), 0.0, "{error:?}");
        }
    }

    #[test]
    fn equal_values_share_their_rank() {
        assert_eq!(ranks(&[3.0, 1.0, 3.0, 2.0]), [2.5, 0.0, 2.5, 1.0]);
    }
}
