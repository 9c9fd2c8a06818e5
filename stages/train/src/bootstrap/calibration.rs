use marf_schema::bootstrap::Calibration;

/// Least spread: one step of 8 bits.
const MIN_STD: f64 = 1.0 / 255.0;
/// z with P(|Z| <= z) = 0.05, 0.10, .. 0.95 for a standard normal Z; written out because erf differs between
/// libraries.
const Z: [f64; 19] = [
    0.062706777943214,
    0.125661346855074,
    0.189118426272792,
    0.2533471031358,
    0.318639363964375,
    0.385320466407568,
    0.45376219016988,
    0.524400512708041,
    0.597760126042478,
    0.674489750196082,
    0.755415026360469,
    0.841621233572914,
    0.93458929107348,
    1.036433389493789,
    1.150349380376008,
    1.281551565544601,
    1.439531470938456,
    1.644853626951472,
    1.959963984540054,
];
/// Share outside the distribution-free interval.
const OUTSIDE: f64 = 0.1;
/// Below so many held-out photos the intervals are hardly tested; the note says so.
const FEW_PHOTOS: usize = 10;
/// Least held-out photos of which one half can fit and the other test.
const LEAST_PHOTOS: usize = 4;

/// Spread and absolute error of the pixels of one photo.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelErrors<'a> {
    /// Standard deviation of a pixel.
    pub std: &'a [f32],
    /// |mean - photo| of a pixel.
    pub error: &'a [f32],
}

/// Returns how far intervals hold: fitted on the photos at even places, tested on those at odd ones. Pixels of one
/// photo stay together, since they are not independent. `None` with fewer than four photos.
pub(crate) fn calibrate(photos: &[PixelErrors<'_>]) -> Option<Calibration> {
    if photos.len() < LEAST_PHOTOS {
        return None;
    }
    let half = |odd: usize| -> Vec<PixelErrors<'_>> { photos.iter().skip(odd).step_by(2).copied().collect() };
    let (fitted, tested) = (half(0), half(1));
    let t = scale_t(&fitted);
    let widest = conformal_score(&fitted, OUTSIDE);
    let note = if photos.len() < FEW_PHOTOS {
        format!(
            "only {} photos were held out: the pixels of one are not independent",
            photos.len()
        )
    } else {
        String::new()
    };
    Some(Calibration {
        t,
        ece: calibration_error(&tested, t),
        coverage90: widest.map(|widest| coverage(&tested, widest)),
        fit_photos: fitted.len() as u64,
        test_photos: tested.len() as u64,
        note,
    })
}

/// Returns e / max(s, 1/255) of every pixel of every photo.
fn scores<'a>(photos: &'a [PixelErrors<'_>]) -> impl Iterator<Item = f64> + 'a {
    let pixels = photos.iter().flat_map(|photo| photo.std.iter().zip(photo.error));
    pixels.map(|(std, error)| f64::from(*error) / f64::from(*std).max(MIN_STD))
}

/// Returns the mean, 0 of no values.
pub(crate) fn mean<T: Into<f64>>(values: impl Iterator<Item = T>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_u64), |(sum, count), value| {
        (sum + value.into(), count + 1)
    });
    sum / count.max(1) as f64
}

/// Returns the share of pixels whose error is at most `widths` standard deviations.
pub(crate) fn coverage(photos: &[PixelErrors<'_>], widths: f64) -> f64 {
    mean(scores(photos).map(|score| f64::from(u8::from(score <= widths))))
}

/// Returns the factor t by which the spread should be widened: t² = mean e² / s².
pub(crate) fn scale_t(photos: &[PixelErrors<'_>]) -> f64 {
    mean(scores(photos).map(|score| score * score)).sqrt()
}

/// Returns the mean negative log-likelihood of the errors under normal distributions of standard deviation
/// `t · max(s, 1/255)`, in nats.
///
/// Uses the platform's logarithm; a caller that stores it rounds it.
pub(crate) fn nll(photos: &[PixelErrors<'_>], t: f64) -> f64 {
    let pixels = photos.iter().flat_map(|photo| photo.std.iter().zip(photo.error));
    mean(pixels.map(|(std, error)| {
        let std = t * f64::from(*std).max(MIN_STD);
        let score = f64::from(*error) / std;
        0.5 * std::f64::consts::TAU.ln() + std.ln() + score * score / 2.0
    }))
}

/// Returns the mean |share inside - nominal| over the nominal shares 0.05 to 0.95.
fn calibration_error(photos: &[PixelErrors<'_>], t: f64) -> f64 {
    let mut inside = [0_u64; Z.len()];
    let mut count = 0_u64;
    for score in scores(photos) {
        count += 1;
        // The intervals lie inside each other: all from the first that holds the score.
        let first = Z.partition_point(|z| z * t < score);
        inside[first..].iter_mut().for_each(|inside| *inside += 1);
    }
    let share = |inside: u64| inside as f64 / count.max(1) as f64;
    let nominal = (1..=Z.len()).map(|twentieth| twentieth as f64 / 20.0);
    mean(
        inside
            .iter()
            .zip(nominal)
            .map(|(inside, nominal)| (share(*inside) - nominal).abs()),
    )
}

/// Returns which of `count` sorted scores (1 is the least) bounds a share of `1 - outside` of new ones:
/// ⌈(count + 1)(1 - outside)⌉; none if that is beyond the last.
pub(crate) fn conformal_rank(count: usize, outside: f64) -> Option<usize> {
    // 1e-9: a product that is whole must not be lifted by its rounding.
    let rank = ((count + 1) as f64 * (1.0 - outside) - 1e-9).ceil().max(1.0) as usize;
    (rank <= count).then_some(rank)
}

/// Returns the score that bounds a share of `1 - outside` of new ones; `None` where there are too few scores.
fn conformal_score(photos: &[PixelErrors<'_>], outside: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = scores(photos).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    conformal_rank(sorted.len(), outside).map(|rank| sorted[rank - 1])
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

    /// Four decimals, as the example is printed; f32 renders leave some 1e-6.
    fn close(found: f64, expected: f64, what: &str) {
        assert!((found - expected).abs() < 6e-5, "{what}: {found}, not {expected}");
    }

    #[test]
    fn the_worked_example_of_intervals_comes_out() {
        let (std, error) = example_error();
        let photos = [PixelErrors {
            std: &std,
            error: &error,
        }];
        for (widths, share) in [(1.0, 0.25), (2.0, 0.5), (3.0, 0.75)] {
            assert_eq!(coverage(&photos, widths), share, "{widths} sd");
        }
        let t = scale_t(&photos);
        close(t, 4.9562, "t");
        close(nll(&photos, 1.0), 9.6407, "NLL");
        close(nll(&photos, t), -0.5408, "NLL after scaling");
        let mut sorted: Vec<f64> = scores(&photos).collect();
        sorted.sort_by(f64::total_cmp);
        for (score, expected) in sorted.into_iter().zip([0.0, 1.9596, 2.0412, 9.5]) {
            close(score, expected, "score");
        }
        assert_eq!(
            (conformal_rank(4, 0.5), conformal_rank(4, 0.2)),
            (Some(3), Some(4))
        );
        close(conformal_score(&photos, 0.5).unwrap(), 2.0412, "half");
        close(conformal_score(&photos, 0.2).unwrap(), 9.5, "four fifths");
        assert_eq!(conformal_rank(4, 0.1), None);
    }

    /// Errors at the quantiles of a normal distribution of the very spread that is claimed.
    fn honest(spread: f32, claimed: f32) -> (Vec<f32>, Vec<f32>) {
        // Between two entries of Z lies a twentieth of the mass; its middle is near the mean of both.
        let middles = Z
            .windows(2)
            .map(|pair| ((pair[0] + pair[1]) / 2.0) as f32 * spread);
        let error: Vec<f32> = std::iter::once(Z[0] as f32 / 2.0 * spread)
            .chain(middles)
            .collect();
        let error = [error, vec![2.24 * spread]].concat();
        (vec![claimed; error.len()], error)
    }

    #[test]
    fn a_spread_that_is_half_the_truth_is_doubled_and_then_covers() {
        let (std, error) = honest(0.1, 0.05);
        let photos = vec![
            PixelErrors {
                std: &std,
                error: &error
            };
            6
        ];
        let found = calibrate(&photos).unwrap();
        assert!((found.t - 2.0).abs() < 0.1, "{found:?}");
        assert!(found.ece < 0.05, "{found:?}");
        assert_eq!((found.fit_photos, found.test_photos), (3, 3));
        assert!(found.note.contains("only 6 photos"));
        assert!((found.coverage90.unwrap() - 0.9).abs() < 0.06, "{found:?}");
    }

    #[test]
    fn three_photos_are_too_few_and_zero_spread_counts_as_one_step_of_8_bits() {
        let (std, error) = (vec![0.0_f32; 5], vec![1.0_f32 / 255.0; 5]);
        let photos = [PixelErrors {
            std: &std,
            error: &error,
        }; 3];
        assert_eq!(calibrate(&photos), None);
        assert!((scale_t(&photos) - 1.0).abs() < 1e-6);
        assert!(nll(&photos, 1.0).is_finite());
    }
}
