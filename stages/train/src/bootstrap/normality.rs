//! How far the errors are normal with the very spread of the members, before anything is fitted.

/// Least spread: one step of 8 bits.
const MIN_STD: f64 = 1.0 / 255.0;

/// Returns |error| / max(s, 1/255) of every pixel of a photo.
fn scores<'a>(std: &'a [f32], error: &'a [f32]) -> impl Iterator<Item = f64> + 'a {
    let pixels = std.iter().zip(error);
    pixels.map(|(std, error)| f64::from(*error) / f64::from(*std).max(MIN_STD))
}

/// Returns the mean, 0 of no values.
pub(crate) fn mean<T: Into<f64>>(values: impl Iterator<Item = T>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_u64), |(sum, count), value| {
        (sum + value.into(), count + 1)
    });
    sum / count.max(1) as f64
}

/// Returns the share of the pixels of a photo whose error is at most `widths` standard deviations.
pub(crate) fn coverage(std: &[f32], error: &[f32], widths: f64) -> f64 {
    mean(scores(std, error).map(|score| f64::from(u8::from(score <= widths))))
}

/// Returns the mean negative log-likelihood of the errors under normal distributions of standard deviation
/// `t · max(s, 1/255)`, in nats.
///
/// Uses the platform's logarithm. A caller that stores the result rounds it.
pub(crate) fn nll(std: &[f32], error: &[f32], t: f64) -> f64 {
    mean(std.iter().zip(error).map(|(std, error)| {
        let std = t * f64::from(*std).max(MIN_STD);
        let score = f64::from(*error) / std;
        0.5 * std::f64::consts::TAU.ln() + std.ln() + score * score / 2.0
    }))
}

#[cfg(test)]
mod tests {
    use super::super::maps::tests::{example, maps_of};
    use super::*;

    const TRUTH: [f32; 4] = [0.50, 0.30, 0.72, 0.60];

    fn example_error() -> (Vec<f32>, Vec<f32>) {
        let maps = maps_of(&example());
        let error = maps
            .gray
            .iter()
            .zip(TRUTH)
            .map(|(gray, truth)| (gray - truth).abs())
            .collect();
        (maps.std, error)
    }

    /// Four decimals, as the example is printed. f32 renders leave some 1e-6.
    fn close(found: f64, expected: f64, what: &str) {
        assert!((found - expected).abs() < 6e-5, "{what}: {found}, not {expected}");
    }

    #[test]
    fn the_worked_example_of_intervals_comes_out() {
        let (std, error) = example_error();
        for (widths, share) in [(1.0, 0.25), (2.0, 0.5), (3.0, 0.75)] {
            assert_eq!(coverage(&std, &error, widths), share, "{widths} sd");
        }
        close(nll(&std, &error, 1.0), 9.6407, "NLL");
        close(nll(&std, &error, 4.9562), -0.5408, "NLL after scaling");
        let mut sorted: Vec<f64> = scores(&std, &error).collect();
        sorted.sort_by(f64::total_cmp);
        for (score, expected) in sorted.into_iter().zip([0.0, 1.9596, 2.0412, 9.5]) {
            close(score, expected, "score");
        }
    }

    #[test]
    fn zero_spread_counts_as_one_step_of_8_bits() {
        let (std, error) = (vec![0.0_f32; 5], vec![1.0_f32 / 255.0; 5]);
        assert_eq!(coverage(&std, &error, 1.001), 1.0);
        assert!(nll(&std, &error, 1.0).is_finite());
    }
}
