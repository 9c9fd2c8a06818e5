//! Exposures of photos from the tones of the points that they share.
//!
//! A photo shows gain * colour + offset, channel by channel. A line through the tones that two photos give their common points has the
//! ratio of their gains as slope. All pairs together give the gains, then the offsets, by weighted least squares. One point in eight is held
//! back at first. Exposures are kept only if photos agree much better there with them than without, and are then solved from all points.

use std::collections::BTreeMap;

use libm::{exp, log};
use marf_numeric::{mix, upper_median};
use marf_scene::{PhotoTone, ToneDifference, Tones};
use nalgebra::{DMatrix, DVector};

/// One point in this many is held back.
const HELD_BACK: u64 = 8;
/// Fewest points that several photos show: an eighth of them measures the differences.
const LEAST_POINTS: usize = 64;
/// Fewest common points of two photos from which their exposures are compared.
pub(crate) const LEAST_COMMON: usize = 8;
/// Fewest points held back by which a photo counts in the differences.
const LEAST_JUDGED: usize = 4;
/// A photo of a point is paired with as many that follow.
const PARTNERS: usize = 3;
/// Tones outside are clipped, or so near to it that JPEG may have moved them.
const UNCLIPPED: std::ops::RangeInclusive<u8> = 3..=250;
/// Least correlation of the tones in two photos. Below it the slope says nothing.
const LEAST_CORRELATION: f64 = 0.5;
/// Rounds of reweighting. The weights of the worst cases in the tests settle in 10.
pub(crate) const ROUNDS: usize = 12;
/// Residuals of this many standard deviations have half the weight (Cauchy's weights, 95 % efficient on normal noise).
const CAUCHY: f64 = 2.385;
/// Standard deviation of normal noise over its median absolute deviation.
pub(crate) const SIGMA_PER_MEDIAN: f64 = 1.4826;
/// Least standard deviation of a tone: that of rounding to 8 bits.
const ROUNDING: f64 = 0.29 / 255.0;

/// The tone of a point in a photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointTone {
    /// Index of the photo.
    pub photo: usize,
    /// [`radius2`](marf_scene::Camera::radius2) of its pixel.
    pub radius2: f64,
    /// sRGB with white = 1.
    pub tone: [f64; 3],
}

impl PointTone {
    /// Returns the tone that a photo shows in 8 bits. `None` if it is clipped.
    pub fn unclipped(photo: usize, radius2: f64, rgb: [u8; 3]) -> Option<Self> {
        let is_unclipped = rgb.iter().all(|channel| UNCLIPPED.contains(channel));
        is_unclipped.then(|| Self {
            photo,
            radius2,
            tone: rgb.map(|channel| f64::from(channel) / 255.0),
        })
    }
}

/// Gain and offset of a photo in one channel. Neutral by default.
#[derive(Clone, Copy, Default)]
struct Exposure {
    log_gain: f64,
    offset: f64,
}

/// Those of the three channels.
type Exposures = [Exposure; 3];

/// Returns what the tones of points say of the exposures of photos. `None` if photos share too few points.
///
/// - `ids`: those of the photos, sorted.
/// - `points`: for each point its tones in these photos.
pub fn find_tones(ids: &[&str], points: &[Vec<PointTone>]) -> Option<Tones> {
    let photos = ids.len();
    let all = points.iter().map(Vec::as_slice);
    let shared: Vec<&[PointTone]> = all.filter(|tones| tones.len() > 1).collect();
    if shared.len() < LEAST_POINTS {
        return None;
    }
    let (judging, solving): (Vec<_>, Vec<_>) = shared
        .iter()
        .enumerate()
        .partition(|(index, _)| mix(*index as u64).is_multiple_of(HELD_BACK));
    let found = solve(&pairs(solving.iter().map(|(_, tones)| **tones)), photos);
    let is_known = |seen: &&PointTone| found[seen.photo].is_some();
    let judging = judging
        .iter()
        .map(|(_, tones)| tones.iter().filter(is_known).copied());
    let mut judging: Vec<Vec<PointTone>> = judging.map(Iterator::collect).collect();
    judging.retain(|tones| tones.len() > 1);
    let difference = ToneDifference {
        points: shared.len() as u64,
        spread: difference(&judging, &vec![None; photos])?,
        noise: difference(&judging, &found)?,
    };
    let is_real = difference.is_real();
    let exposures = is_real.then(|| solve(&pairs(shared.into_iter()), photos));
    let tone = |(exposure, id): (Option<Exposures>, &&str)| {
        let exposure = exposure?;
        Some(PhotoTone {
            id: (*id).to_owned(),
            log_gain: exposure.map(|channel| channel.log_gain),
            offset: exposure.map(|channel| channel.offset),
        })
    };
    let photos = exposures
        .into_iter()
        .flatten()
        .zip(ids)
        .filter_map(tone)
        .collect();
    Some(Tones {
        difference,
        photos,
        vignetting: Vec::new(),
    })
}

/// Tones of common points by pairs of photos, the lower index first.
pub(crate) type Pairs = BTreeMap<[usize; 2], Vec<[PointTone; 2]>>;

pub(crate) fn pairs<'a>(points: impl Iterator<Item = &'a [PointTone]>) -> Pairs {
    let mut pairs = Pairs::new();
    for tones in points {
        for (index, a) in tones.iter().enumerate() {
            for b in tones[index + 1..].iter().take(PARTNERS) {
                let (low, high) = if a.photo < b.photo { (a, b) } else { (b, a) };
                if low.photo != high.photo {
                    let common = pairs.entry([low.photo, high.photo]).or_default();
                    common.push([*low, *high]);
                }
            }
        }
    }
    pairs
}

/// Returns the exposures of all photos. `None` for those that share too few points with others.
fn solve(pairs: &Pairs, photos: usize) -> Vec<Option<Exposures>> {
    let channels = [0, 1, 2].map(|channel| solve_channel(pairs, photos, channel));
    let exposure = |photo: usize| {
        let [red, green, blue] = channels.each_ref().map(|channel| channel[photo]);
        Some([red?, green?, blue?])
    };
    (0..photos).map(exposure).collect()
}

fn solve_channel(pairs: &Pairs, photos: usize, channel: usize) -> Vec<Option<Exposure>> {
    let lines = pairs.iter().filter_map(|(pair, common)| {
        let tones: Vec<[f64; 2]> = common
            .iter()
            .map(|both| both.map(|seen| seen.tone[channel]))
            .collect();
        Some((*pair, line(&tones)?))
    });
    let lines: Vec<([usize; 2], Line)> = lines.collect();
    let differences = lines.iter().map(|(pair, line)| Difference {
        pair: *pair,
        value: log(line.slope),
        weight: line.weight,
    });
    let log_gains = least_squares(&differences.collect::<Vec<_>>(), photos);
    let gains: Vec<f64> = log_gains.iter().map(|log_gain| exp(*log_gain)).collect();
    // The colours that two photos show as their mean tones are equal, so that m / gain - offset / gain is.
    let differences = lines.iter().map(|(pair, line)| {
        let [low, high] = [0, 1].map(|side| line.means[side] / gains[pair[side]]);
        Difference {
            pair: *pair,
            value: high - low,
            weight: line.weight,
        }
    });
    let shifts = least_squares(&differences.collect::<Vec<_>>(), photos);
    let mut is_known = vec![false; photos];
    for photo in lines.iter().flat_map(|(pair, _)| pair) {
        is_known[*photo] = true;
    }
    let exposure = |photo: usize| Exposure {
        log_gain: log_gains[photo],
        offset: gains[photo] * shifts[photo],
    };
    (0..photos)
        .map(|photo| is_known[photo].then(|| exposure(photo)))
        .collect()
}

/// A line through the tones that two photos give their common points.
struct Line {
    slope: f64,
    /// Mean tone in each photo.
    means: [f64; 2],
    /// One over the variance of the logarithm of the slope.
    weight: f64,
}

/// Fits a line to tones with equal noise in both photos (Deming's regression), reweighted against outliers. `None` if they are too few, or
/// hardly correlate.
fn line(tones: &[[f64; 2]]) -> Option<Line> {
    if tones.len() < LEAST_COMMON {
        return None;
    }
    let mut weights = vec![1.0; tones.len()];
    let mut found = None;
    for _ in 0..ROUNDS {
        let line = weighted_line(tones, &weights)?;
        let scale = 1.0 / (1.0 + line.slope * line.slope).sqrt();
        let residual =
            |[x, y]: &[f64; 2]| (y - line.means[1] - line.slope * (x - line.means[0])).abs() * scale;
        weights = trusted(tones.iter().map(residual).collect());
        found = Some(line);
    }
    found
}

fn weighted_line(tones: &[[f64; 2]], weights: &[f64]) -> Option<Line> {
    let sum = |value: &dyn Fn(&[f64; 2]) -> f64| -> f64 {
        let terms = tones.iter().zip(weights);
        terms.map(|(tone, weight)| weight * value(tone)).sum()
    };
    let all = sum(&|_| 1.0);
    let means = [sum(&|tone| tone[0]) / all, sum(&|tone| tone[1]) / all];
    let moment = |a: usize, b: usize| sum(&|tone| (tone[a] - means[a]) * (tone[b] - means[b])) / all;
    let (xx, xy, yy) = (moment(0, 0), moment(0, 1), moment(1, 1));
    let correlation = xy / (xx * yy).sqrt();
    if xx.min(yy) < ROUNDING * ROUNDING || correlation < LEAST_CORRELATION {
        return None;
    }
    let across = yy - xx;
    let slope = (across + (across * across + 4.0 * xy * xy).sqrt()) / (2.0 * xy);
    let explained = correlation * correlation;
    Some(Line {
        slope,
        means,
        weight: all * explained / (1.0 - explained).max(1e-3),
    })
}

/// A value of the second photo less that of the first.
struct Difference {
    pair: [usize; 2],
    value: f64,
    weight: f64,
}

/// Returns the values of all photos by least squares, reweighted against outliers. A pull to 0 of a billionth of all weights
/// gives each connected part a mean of 0.
fn least_squares(differences: &[Difference], photos: usize) -> Vec<f64> {
    let mut values = DVector::zeros(photos);
    let mut trust = vec![1.0; differences.len()];
    let pull = 1e-9 * differences.iter().map(|one| one.weight).sum::<f64>();
    for _ in 0..ROUNDS / 4 {
        let mut normal = DMatrix::from_diagonal_element(photos, photos, pull);
        let mut right = DVector::zeros(photos);
        for (Difference { pair, value, weight }, trust) in differences.iter().zip(&trust) {
            let ([low, high], weight) = (*pair, weight * trust);
            normal[(low, low)] += weight;
            normal[(high, high)] += weight;
            normal[(low, high)] -= weight;
            normal[(high, low)] -= weight;
            right[low] -= weight * value;
            right[high] += weight * value;
        }
        // A sum of squares and a pull is positive definite.
        values = normal.cholesky().map_or(values, |factors| factors.solve(&right));
        let residual = |one: &Difference| (values[one.pair[1]] - values[one.pair[0]] - one.value).abs();
        trust = trusted(differences.iter().map(residual).collect());
    }
    values.iter().copied().collect()
}

/// Returns the weights of residuals, by their median.
pub(crate) fn trusted(residuals: Vec<f64>) -> Vec<f64> {
    let sigma = SIGMA_PER_MEDIAN * upper_median(residuals.iter().copied()).unwrap_or_default();
    let deviations = residuals
        .into_iter()
        .map(|residual| residual / sigma.max(ROUNDING));
    deviations
        .map(|deviation| 1.0 / (1.0 + (deviation / CAUCHY).powi(2)))
        .collect()
}

/// Returns how far photos differ in the colours of points, as a share of the mean colour: the root of the mean square over photos of each
/// photo's typical difference from the other photos of a point. `None` if no two photos can be judged.
fn difference(points: &[Vec<PointTone>], exposures: &[Option<Exposures>]) -> Option<f64> {
    let mut squares: Vec<Vec<f64>> = vec![Vec::new(); exposures.len()];
    let (mut sum, mut count) = (0.0, 0.0);
    for tones in points {
        let color = |seen: &PointTone| {
            let exposure = exposures[seen.photo].unwrap_or_default();
            [0, 1, 2].map(|k| (seen.tone[k] - exposure[k].offset) / exp(exposure[k].log_gain))
        };
        let colors: Vec<[f64; 3]> = tones.iter().map(color).collect();
        let total = [0, 1, 2].map(|channel| colors.iter().map(|color| color[channel]).sum::<f64>());
        let others = (colors.len() - 1) as f64;
        for (seen, color) in tones.iter().zip(&colors) {
            let apart = |channel: usize| color[channel] - (total[channel] - color[channel]) / others;
            squares[seen.photo].push([0, 1, 2].map(|channel| apart(channel).powi(2)).iter().sum());
        }
        sum += total.iter().sum::<f64>();
        count += 3.0 * colors.len() as f64;
    }
    let judged = squares
        .into_iter()
        .filter(|squares| squares.len() >= LEAST_JUDGED);
    let typical: Vec<f64> = judged.filter_map(upper_median).collect();
    let mean_square = typical.iter().sum::<f64>() / (3.0 * typical.len() as f64);
    (typical.len() > 1).then(|| mean_square.sqrt() / (sum / count))
}

#[cfg(test)]
mod tests;
