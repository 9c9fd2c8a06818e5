//! Intervals that hold: the spread of the members widened until errors on held-out photos are within it as often as stated.

use std::collections::BTreeSet;

use marf_numeric::lower_median;
use marf_schema::bootstrap::Calibration;

/// z with P(|Z| <= z) = 0.05, 0.10, .. 0.95 for a standard normal Z, as a table because erf differs between libraries.
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
/// Share of a normal distribution within one standard deviation.
const ONE_SD: f64 = 0.682_689_492_137_086;
/// Twentieths inside the interval that maps show.
const NINETY: usize = 18;
/// Fewer places than this cannot be left out in turn.
const LEAST_PLACES: usize = 2;
/// With fewer places, the share of a new one may be far from their mean. The note says so.
const FEW_PLACES: usize = 8;
/// Fewest errors from which a share is computed.
const LEAST_ERRORS: usize = 100;
/// Most errors of a view that are looked at, evenly spaced: shares of more are the same.
const MOST_ERRORS: usize = 1 << 14;
/// Rows and columns on each side of a pixel whose variances are averaged with its own.
const AROUND: usize = 2;

/// Least spreads of gray that are tried, sRGB in [0, 1]: what members agree on may still differ from a photo, by noise and by what no
/// field resolves.
pub(crate) const GRAY_FLOORS: [f64; 5] = [1.0 / 255.0, 2.0 / 255.0, 4.0 / 255.0, 8.0 / 255.0, 16.0 / 255.0];
/// The same of depths, shares of the depth.
pub(crate) const DEPTH_FLOORS: [f64; 6] = [0.000_5, 0.001, 0.002, 0.004, 0.008, 0.016];

/// Spreads and absolute errors at one viewpoint.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Errors {
    /// Number of the place that the photo was taken at.
    pub place: usize,
    /// Spread of the members and error of their mean, both in the same unit.
    pub pairs: Vec<(f32, f32)>,
    /// Share of the view's pixels that have no interval, since no photo saw them.
    pub unseen_share: f64,
}

impl Errors {
    /// Keeps some of all pairs, evenly spaced.
    pub fn new(place: usize, all: Vec<(f32, f32)>, unseen_share: f64) -> Self {
        let stride = all.len().div_ceil(MOST_ERRORS).max(1);
        Self {
            place,
            pairs: all.into_iter().step_by(stride).collect(),
            unseen_share,
        }
    }
}

/// What makes intervals of a spread.
#[derive(Debug, Clone, PartialEq)]
struct Fit {
    floor: f64,
    t: f64,
    /// Spreads that bound 0.05, 0.10, .. 0.95 of the errors.
    factors: Vec<f64>,
}

/// Returns √(spread² + floor²).
pub(crate) fn widened(spread: f32, floor: f64) -> f64 {
    let spread = f64::from(spread);
    (spread * spread + floor * floor).sqrt()
}

/// Fits the calibration to the errors at all viewpoints and checks it by leaving out one place at a time. The intervals fitted on the other
/// places are compared with the errors of that place.
///
/// Views without errors count for the share that no photo saw only. `None` with fewer than 100 errors, or fewer than two places checked.
pub(crate) fn calibrate(views: &[Errors], floors: &[f64]) -> Option<Calibration> {
    let compared: Vec<&Errors> = views.iter().filter(|view| !view.pairs.is_empty()).collect();
    let places: BTreeSet<usize> = compared.iter().map(|view| view.place).collect();
    let errors: usize = compared.iter().map(|view| view.pairs.len()).sum();
    if errors < LEAST_ERRORS {
        return None;
    }
    let fit = fit(&compared, floors)?;
    let checks = places.iter().filter_map(|place| {
        let (left_out, others): (Vec<_>, Vec<_>) =
            compared.iter().copied().partition(|view| view.place == *place);
        check(&left_out, &self::fit(&others, floors)?)
    });
    let checks: Vec<Check> = checks.collect();
    if checks.len() < LEAST_PLACES {
        return None;
    }
    let count = checks.len() as f64;
    let inside: Vec<f64> = (0..Z.len())
        .map(|at| checks.iter().map(|check| check.inside[at]).sum::<f64>() / count)
        .collect();
    let range = |value: fn(&Check) -> f64| {
        let values = checks.iter().map(value);
        [
            values.clone().fold(f64::INFINITY, f64::min),
            values.fold(f64::NEG_INFINITY, f64::max),
        ]
    };
    let note = if checks.len() < FEW_PLACES {
        format!(
            "only {} places were held out: a new one may be unlike them",
            checks.len()
        )
    } else {
        String::new()
    };
    Some(Calibration {
        floor: fit.floor,
        t: fit.t,
        factor90: fit.factors[NINETY - 1],
        ece: checks.iter().map(Check::ece).sum::<f64>() / count,
        ece_range: range(Check::ece),
        coverage90: inside[NINETY - 1],
        coverage90_range: range(|check| check.inside[NINETY - 1]),
        inside,
        median_error: median(views, |(_, error)| f64::from(error)),
        median_half90: fit.factors[NINETY - 1] * median(views, |(spread, _)| widened(spread, fit.floor)),
        errors: errors as u64,
        places: checks.len() as u64,
        views: compared.len() as u64,
        unseen_share: views.iter().map(|view| view.unseen_share).sum::<f64>() / views.len() as f64,
        note,
    })
}

/// Returns the lower median of a value over all pixels of all views.
fn median(views: &[Errors], value: impl Fn((f32, f32)) -> f64) -> f64 {
    let pairs = views.iter().flat_map(|view| view.pairs.iter().copied());
    lower_median(pairs.map(value)).unwrap_or(0.0)
}

/// Returns the floor for which errors are most nearly normal, with its factors, or `None` without errors.
fn fit(views: &[&Errors], floors: &[f64]) -> Option<Fit> {
    let fits = floors.iter().filter_map(|floor| {
        let scores = scores(views, *floor);
        let fit = Fit {
            floor: *floor,
            t: score_within(&scores, ONE_SD)?,
            factors: twentieths()
                .map(|share| score_within(&scores, share))
                .collect::<Option<_>>()?,
        };
        let normal = Z.map(|z| share_within(&scores, z * fit.t));
        Some((calibration_error(&normal), fit))
    });
    let best = fits.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, fit)| fit)
}

/// How intervals hold at views that they were not fitted on.
struct Check {
    /// Shares inside the intervals of 0.05, 0.10, .. 0.95.
    inside: Vec<f64>,
}

impl Check {
    fn ece(&self) -> f64 {
        calibration_error(&self.inside)
    }
}

/// Checks a fit at views that it has not seen. `None` without errors.
fn check(views: &[&Errors], fit: &Fit) -> Option<Check> {
    let scores = scores(views, fit.floor);
    (!scores.is_empty()).then(|| Check {
        inside: fit
            .factors
            .iter()
            .map(|factor| share_within(&scores, *factor))
            .collect(),
    })
}

/// Returns error over widened spread of every pair, sorted.
fn scores(views: &[&Errors], floor: f64) -> Vec<f64> {
    let pairs = views.iter().flat_map(|view| &view.pairs);
    let mut scores: Vec<f64> = pairs
        .map(|(spread, error)| f64::from(*error) / widened(*spread, floor))
        .collect();
    scores.sort_unstable_by(f64::total_cmp);
    scores
}

/// Returns the share of sorted scores that are at most `widths`.
fn share_within(sorted: &[f64], widths: f64) -> f64 {
    sorted.partition_point(|score| *score <= widths) as f64 / sorted.len().max(1) as f64
}

/// Returns the stated shares 0.05, 0.10, .. 0.95.
fn twentieths() -> impl Iterator<Item = f64> {
    (1..=Z.len()).map(|twentieth| twentieth as f64 / 20.0)
}

/// Returns the mean |share inside - stated|.
fn calibration_error(inside: &[f64]) -> f64 {
    let gaps = inside
        .iter()
        .zip(twentieths())
        .map(|(inside, nominal)| (inside - nominal).abs());
    gaps.sum::<f64>() / Z.len() as f64
}

/// Returns which of `count` sorted scores (1 is the least) bounds a share `inside` of new ones: ⌈(count + 1) inside⌉.
///
/// `None` if that is beyond the last score (split conformal prediction: the bound holds whatever the distribution is).
pub(crate) fn conformal_rank(count: usize, inside: f64) -> Option<usize> {
    // 1e-9: a product that is whole must not be lifted by its rounding.
    let rank = ((count + 1) as f64 * inside - 1e-9).ceil().max(1.0) as usize;
    (rank <= count).then_some(rank)
}

/// Returns the score that bounds a share of new ones, or `None` if there are too few scores.
fn score_within(sorted: &[f64], inside: f64) -> Option<f64> {
    conformal_rank(sorted.len(), inside).map(|rank| sorted[rank - 1])
}

/// Returns [`locally_within`] of 5 x 5 pixels: the variance of five members scatters by a third from pixel to pixel, that of what they show
/// does not.
pub(crate) fn locally(values: &[f32], width: u32) -> Vec<f32> {
    locally_within(values, width, AROUND)
}

/// Returns the root mean square of the values up to `around` rows and columns from each. Negative values mean no value: they stay and are
/// not averaged.
pub(crate) fn locally_within(values: &[f32], width: u32, around: usize) -> Vec<f32> {
    let width = width.max(1) as usize;
    let height = values.len() / width;
    let span = |place: usize, end: usize| place.saturating_sub(around)..(place + around + 1).min(end);
    let mean = |pixel: usize| {
        let (column, row) = (pixel % width, pixel / width);
        let (mut sum, mut count) = (0.0, 0_u32);
        for row in span(row, height) {
            for value in &values[row * width..][span(column, width)] {
                if *value >= 0.0 {
                    sum += f64::from(*value) * f64::from(*value);
                    count += 1;
                }
            }
        }
        (sum / f64::from(count.max(1))).sqrt() as f32
    };
    let local = |pixel: usize| {
        if values[pixel] < 0.0 {
            values[pixel]
        } else {
            mean(pixel)
        }
    };
    (0..values.len()).map(local).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors at the quantiles of a normal distribution of the standard deviation `sd`, 50 in each twentieth.
    fn normal(place: usize, spread: f32, sd: f64) -> Errors {
        let ends: Vec<f64> = [0.0].into_iter().chain(Z).chain([2.8]).collect();
        let between = |pair: &[f64]| {
            let (low, high) = (pair[0], pair[1]);
            (0..50).map(move |part| low + (high - low) * (f64::from(part) + 0.5) / 50.0)
        };
        let quantiles = ends.windows(2).flat_map(between);
        let pairs = quantiles.map(|z| (spread, (z * sd) as f32));
        Errors::new(place, pairs.collect(), 0.25)
    }

    #[test]
    fn a_spread_that_is_half_the_truth_is_doubled_and_then_covers() {
        let views: Vec<Errors> = (0..3).map(|place| normal(place, 0.05, 0.1)).collect();
        let found = calibrate(&views, &[1e-6]).unwrap();
        assert!((found.t - 2.0).abs() < 0.1, "{found:?}");
        assert!((found.factor90 - 3.3).abs() < 0.3, "{found:?}");
        assert!(found.ece < 0.03, "{found:?}");
        assert!(
            found.inside.is_sorted() && (found.inside[9] - 0.5).abs() < 0.05,
            "{found:?}"
        );
        assert!((found.coverage90 - 0.9).abs() < 0.03, "{found:?}");
        // Half of a normal distribution is within 0.6745 standard deviations of 0.1.
        assert!((found.median_error - 0.06745).abs() < 1e-3, "{found:?}");
        let half = 0.05 * found.factor90;
        assert!((found.median_half90 - half).abs() < 1e-6, "{found:?}");
        assert_eq!(found.errors, 3 * 1000);
        assert_eq!((found.places, found.views, found.unseen_share), (3, 3, 0.25));
        assert!(found.note.contains("only 3 places"), "{found:?}");
    }

    #[test]
    fn a_place_unlike_the_others_shows_in_the_range() {
        let mut views: Vec<Errors> = (0..8).map(|place| normal(place, 0.05, 0.05)).collect();
        views.push(normal(8, 0.05, 0.2));
        let found = calibrate(&views, &[1e-6]).unwrap();
        assert!(
            found.coverage90_range[0] < 0.5 && found.coverage90_range[1] > 0.88,
            "{found:?}"
        );
        assert!(
            found.ece_range[0] < found.ece && found.ece < found.ece_range[1],
            "{found:?}"
        );
        assert_eq!(found.note, "");
    }

    #[test]
    fn the_floor_that_makes_errors_normal_is_taken() {
        // The members agree more and more from view to view. The photos have noise of 4 of 255.
        let views: Vec<Errors> = [0.05_f32, 0.02, 0.004, 0.0]
            .into_iter()
            .enumerate()
            .map(|(place, spread)| normal(place, spread, widened(spread, 4.0 / 255.0)))
            .collect();
        let found = calibrate(&views, &GRAY_FLOORS).unwrap();
        assert_eq!(found.floor, 4.0 / 255.0);
        assert!((found.t - 1.0).abs() < 0.05 && found.ece < 0.02, "{found:?}");
    }

    #[test]
    fn the_stated_coverage_is_a_point_of_the_curve_whatever_the_errors_are() {
        // Most errors are small and a few large: a normal distribution with the same 68 % covers too few at 90 %.
        let heavy = |place: usize| {
            let errors = (0..1000).map(|index| {
                (
                    0.1,
                    if index % 8 == 0 {
                        1.0
                    } else {
                        0.1 * index as f32 / 1000.0
                    },
                )
            });
            Errors::new(place, errors.collect(), 0.0)
        };
        let found = calibrate(&[heavy(0), heavy(1), heavy(2)], &[1e-6]).unwrap();
        assert_eq!(found.coverage90, found.inside[NINETY - 1], "{found:?}");
        assert!(found.coverage90 >= 0.9, "{found:?}");
        assert!(1.645 * found.t < 0.5 * found.factor90, "{found:?}");
    }

    #[test]
    fn one_place_or_few_errors_tell_nothing() {
        let twins = [normal(0, 0.1, 0.1), normal(0, 0.1, 0.1)];
        assert_eq!(calibrate(&twins, &[0.1]), None);
        let few = |place: usize| Errors::new(place, vec![(0.1, 0.1); 49], 0.0);
        assert_eq!(calibrate(&[few(0), few(1)], &[0.1]), None);
        assert_eq!(calibrate(&[], &[0.1]), None);
    }

    #[test]
    fn places_without_errors_are_not_counted() {
        let empty = |place: usize| Errors::new(place, Vec::new(), 0.75);
        let known = [normal(0, 0.05, 0.1), normal(1, 0.05, 0.1)];
        let views = [&known[..], &[empty(1), empty(2)]].concat();
        let found = calibrate(&views, &[1e-6]).unwrap();
        assert_eq!((found.places, found.views, found.unseen_share), (2, 2, 0.5));
        assert!(found.note.contains("only 2 places"), "{found:?}");
        assert_eq!(found.inside, calibrate(&known, &[1e-6]).unwrap().inside);
        // Three errors alone bound no 90 %, so that the other place cannot be checked.
        let few = Errors::new(1, vec![(0.05, 0.1); 3], 0.0);
        assert_eq!(calibrate(&[normal(0, 0.05, 0.1), few], &[1e-6]), None);
    }

    #[test]
    fn without_any_spread_the_floor_alone_makes_the_interval() {
        let view = |place: usize| Errors::new(place, vec![(0.0, 0.0); 200], 0.0);
        let found = calibrate(&[view(0), view(1)], &GRAY_FLOORS).unwrap();
        assert_eq!((found.t, found.factor90, found.coverage90), (0.0, 0.0, 1.0));
        assert!(found.ece.is_finite());
    }

    #[test]
    fn the_worked_example_of_conformal_scores_comes_out() {
        let sorted = [0.0, 1.9596, 2.0412, 9.5];
        assert_eq!(
            (conformal_rank(4, 0.5), conformal_rank(4, 0.8)),
            (Some(3), Some(4))
        );
        assert_eq!(
            (score_within(&sorted, 0.5), score_within(&sorted, 0.8)),
            (Some(2.0412), Some(9.5))
        );
        assert_eq!(conformal_rank(4, 0.9), None);
    }

    #[test]
    fn variances_are_averaged_around_a_pixel_and_what_has_none_stays_out() {
        let mut values = vec![3.0_f32; 49];
        values[24] = 5.0;
        let local = locally(&values, 7);
        assert!((f64::from(local[24]) - ((24.0 * 9.0 + 25.0_f64) / 25.0).sqrt()).abs() < 1e-6);
        assert_eq!((local[0], local[6]), (3.0, 3.0));
        values[24] = -1.0;
        let local = locally(&values, 7);
        assert_eq!((local[24], local[23]), (-1.0, 3.0));
        assert!(locally(&[], 0).is_empty());
    }

    #[test]
    fn of_many_errors_some_are_kept() {
        let many = Errors::new(0, vec![(0.0, 0.0); 3 * MOST_ERRORS], 0.0);
        assert_eq!(many.pairs.len(), MOST_ERRORS);
    }
}
