//! LO-RANSAC (Chum, Matas, Kittler 2003) with truncated squared errors: the model with the best consensus among many
//! wrong measurements.

use marf_numeric::Rng;

/// When to stop sampling.
#[derive(Debug, Clone, Copy)]
pub struct RansacOptions {
    /// Largest number of samples.
    pub max_samples: u32,
    /// Wanted probability of having drawn one sample without outliers.
    pub confidence: f64,
    /// The smallest useful consensus: no samples are drawn to find a smaller one.
    pub min_inliers: usize,
}

/// A model and its inliers.
#[derive(Debug, Clone)]
pub struct Consensus<M> {
    /// The model.
    pub model: M,
    /// Sum of min(e² / threshold², 1) over all measurements.
    pub cost: f64,
    /// Indices of measurements within the threshold, rising.
    pub inliers: Vec<usize>,
}

/// Rounds of local optimisation per new best model.
const ROUNDS: usize = 2;

impl RansacOptions {
    /// Returns the best model found: draws samples of `N`, solves, scores, and improves every new best model on its own
    /// inliers.
    ///
    /// `error2(model, i)` is a squared error in units of the squared threshold. Serial. Of two models of equal cost the first
    /// is kept. `None` with fewer than `N` measurements or no model at all.
    pub fn lo_ransac<const N: usize, M: Clone>(
        &self,
        count: usize,
        rng: &mut Rng,
        solve: impl Fn(&[usize; N]) -> Vec<M>,
        error2: impl Fn(&M, usize) -> f64,
        improve: impl Fn(&M, &[usize]) -> Option<M>,
    ) -> Option<Consensus<M>> {
        if count < N {
            return None;
        }
        let mut best: Option<Consensus<M>> = None;
        let (mut drawn, mut needed) = (0, self.samples_needed(self.min_inliers, count, N));
        while drawn < needed {
            drawn += 1;
            for model in solve(&rng.sample::<N>(count)) {
                let Some(found) = scored_if_better(model, count, best.as_ref(), &error2) else {
                    continue;
                };
                let found = locally_optimised(found, count, &error2, &improve);
                let agreed = found.inliers.len().max(self.min_inliers);
                needed = needed.min(self.samples_needed(agreed, count, N));
                best = Some(found);
            }
        }
        best
    }

    /// Returns the number of samples needed: ln(1 - confidence) / ln(1 - share^N), at most `max_samples`.
    fn samples_needed(&self, agreed: usize, count: usize, sample: usize) -> u32 {
        let share = (agreed as f64 / count as f64).min(1.0);
        let clean = (0..sample).fold(1.0, |product, _| product * share);
        let missed = libm::log1p(-clean);
        let wanted = libm::log1p(-self.confidence.clamp(0.0, 1.0 - 1e-12)) / missed;
        if missed < 0.0 && wanted < f64::from(self.max_samples) {
            (wanted.ceil() as u32).max(1)
        } else {
            self.max_samples
        }
    }
}

/// Returns a consensus improved on its own inliers until its cost stops falling, at most `ROUNDS` times.
pub(crate) fn locally_optimised<M: Clone>(
    mut found: Consensus<M>,
    count: usize,
    error2: &impl Fn(&M, usize) -> f64,
    improve: &impl Fn(&M, &[usize]) -> Option<M>,
) -> Consensus<M> {
    for _ in 0..ROUNDS {
        let next = improve(&found.model, &found.inliers);
        match next.and_then(|model| scored_if_better(model, count, Some(&found), error2)) {
            Some(next) => found = next,
            None => break,
        }
    }
    found
}

/// Returns the consensus of a model, or `None` unless its cost is below that of the best. Stops summing at that
/// bound.
pub(crate) fn scored_if_better<M>(
    model: M,
    count: usize,
    best: Option<&Consensus<M>>,
    error2: &impl Fn(&M, usize) -> f64,
) -> Option<Consensus<M>> {
    let bound = best.map_or(count as f64, |best| best.cost);
    let mut cost = 0.0;
    for i in 0..count {
        // `min` drops a NaN: a measurement without an error is not an inlier.
        cost += error2(&model, i).min(1.0);
        if cost >= bound {
            return None;
        }
    }
    let inliers = (0..count).filter(|&i| error2(&model, i) <= 1.0).collect();
    Some(Consensus { model, cost, inliers })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A number most agree on: one measurement is a sample, the mean of inliers improves it.
    fn mode(values: &[f64], least: usize) -> Option<Consensus<f64>> {
        let options = RansacOptions {
            max_samples: 500,
            confidence: 0.999,
            min_inliers: least,
        };
        let mean = |_: &f64, inliers: &[usize]| {
            Some(inliers.iter().map(|&i| values[i]).sum::<f64>() / inliers.len() as f64)
        };
        let solve = |sample: &[usize; 1]| vec![values[sample[0]]];
        let error2 = |model: &f64, i: usize| (values[i] - model) * (values[i] - model) / 0.04;
        options.lo_ransac(values.len(), &mut Rng::new(1), solve, error2, mean)
    }

    #[test]
    fn the_mode_is_found_and_improved_among_outliers_and_nan() {
        let mut values = vec![1.0, 1.1, 0.9, 1.05, 0.95];
        values.extend((0..40).map(|i| 10.0 + f64::from(i)));
        values.push(f64::NAN);
        let found = mode(&values, 2).unwrap();
        assert_eq!(found.inliers, [0, 1, 2, 3, 4]);
        assert!((found.model - 1.0).abs() < 1e-15, "{}", found.model);
        assert!(mode(&[], 2).is_none());
    }

    #[test]
    fn the_number_of_samples_follows_the_share_of_inliers() {
        let options = RansacOptions {
            max_samples: 2000,
            confidence: 0.999,
            min_inliers: 15,
        };
        // Seven points: ln 0.001 / ln(1 - 0.5^7) = 880.8. Five points: 217.6. All inliers: 1.
        assert_eq!(options.samples_needed(50, 100, 7), 881);
        assert_eq!(options.samples_needed(50, 100, 5), 218);
        assert_eq!(options.samples_needed(100, 100, 7), 1);
        assert_eq!(options.samples_needed(0, 100, 7), 2000);
    }
}
