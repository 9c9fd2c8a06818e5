//! Parts of the picture that stand still while the rest changes: the rover's own body, a lens hood, dust on the window.
//!
//! Photos are compared in pairs, window by window, by the correlation of their gray values, which neither exposure nor haze changes. The
//! picture stands still where both windows have texture and agree in most of the pairs in which the camera has moved. Watermarks, too, are
//! found by structure that persists over a set of pictures (Dekel et al., CVPR 2017). The area that such edges enclose is added, so that a
//! plain deck is found by its rim.

use marf_numeric::{lower_median, visit_parts};

/// Half the side of a window, pixels: windows of 7 x 7.
const HALF_WINDOW: usize = 3;
/// Standard deviation of a window that has texture, gray levels of 255.
const TEXTURE: f64 = 4.0;
/// Windows agree from this correlation on ...
const AGREE: f64 = 0.8;
/// ... and differ below this one.
const DIFFER: f64 = 0.5;
/// The camera has moved between two photos if at least this share of the windows with texture differs.
const MOVED_SHARE: f64 = 0.25;
/// Pairs in which the camera has moved, and in which a window has texture, that are needed to say something.
pub(crate) const LEAST_PAIRS: u32 = 8;
/// A window stands still if it agrees in at least this share of them. Two windows with nothing but an edge each agree by chance
/// in every second pair.
const STATIONARY_SHARE: f64 = 0.75;
/// Windows agree only if neither has more contrast than the other by this factor.
const CONTRAST: f64 = 2.0;
/// Sets of at most this many photos are compared in all pairs.
const ALL_PAIRS: usize = 16;
/// Gaps up to twice this share of the longer side are closed.
const CLOSED_SHARE: f64 = 0.03;
/// Parts smaller than this share of the picture are dropped.
const LEAST_PART: f64 = 0.004;
/// The area within the rim is added where at least this share of it changes as little as the stationary parts.
const QUIET_SHARE: f64 = 0.9;
/// A pixel is quiet in a pair if its gray values differ by at most so much, once exposure is taken out.
const QUIET: f64 = 8.0;

/// Gray values of a photo, 0 to 255.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Gray {
    pub width: usize,
    /// `[height * width]`, row-major.
    pub values: Vec<f64>,
}

impl Gray {
    fn height(&self) -> usize {
        self.values.len().checked_div(self.width).unwrap_or(0)
    }
}

/// Stationary parts of the pictures of one camera.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StationaryParts {
    /// Pairs that were compared.
    pub pairs: u32,
    /// ... between which the camera has moved.
    pub moved: u32,
    /// Which pixels stand still, `[height * width]`. All false if fewer than 8 pairs moved.
    pub is_stationary: Vec<bool>,
}

impl StationaryParts {
    /// Compares photos of one size in pairs. `known` pixels are hidden already, and neither compared nor found.
    ///
    /// Of at most 16 photos all pairs are compared. Of more, each is paired with the next, with the one a third of the set
    /// further on and with the one halfway, so that some pairs have about the same light and others another view.
    /// O(photos · pixels) time, O(pixels) memory in addition to the photos. No photo, or photos without pixels, give nothing.
    pub(crate) fn find(photos: &[Gray], known: &[bool]) -> Self {
        let (width, height) = photos
            .first()
            .map_or((0, 0), |first| (first.width, first.height()));
        let windows: Vec<Windows> = photos.iter().map(Windows::new).collect();
        let mut votes = Votes::new(width * height);
        let pairs = pairs(photos.len());
        for &(a, b) in &pairs {
            votes.add([&photos[a], &photos[b]], [&windows[a], &windows[b]], known);
        }
        let is_stationary = if votes.moved >= LEAST_PAIRS {
            votes.region(width, known)
        } else {
            vec![false; width * height]
        };
        Self {
            pairs: pairs.len() as u32,
            moved: votes.moved,
            is_stationary,
        }
    }
}

/// Returns the pairs of photos that are compared, each once.
fn pairs(photos: usize) -> Vec<(usize, usize)> {
    let mut strides = match photos {
        0..=ALL_PAIRS => (1..photos).collect(),
        _ => vec![1, photos / 3, photos / 2],
    };
    strides.retain(|stride| (1..photos).contains(stride));
    strides.dedup();
    let pair = |one: usize, stride: usize| {
        let other = (one + stride) % photos;
        (one.min(other), one.max(other))
    };
    let mut pairs: Vec<_> = strides
        .iter()
        .flat_map(|stride| (0..photos).map(move |one| pair(one, *stride)))
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Mean and standard deviation of the window around each pixel.
struct Windows {
    mean: Vec<f64>,
    deviation: Vec<f64>,
}

impl Windows {
    fn new(photo: &Gray) -> Self {
        let squares: Vec<f64> = photo.values.iter().map(|value| value * value).collect();
        let mean = window_means(&photo.values, photo.width);
        let of_squares = window_means(&squares, photo.width).into_iter();
        let deviation = of_squares
            .zip(&mean)
            .map(|(square, mean)| (square - mean * mean).max(0.0).sqrt());
        Self {
            deviation: deviation.collect(),
            mean,
        }
    }
}

/// Returns the mean of the window around each pixel, cut at the edges of the picture. It sums over rows, then over columns.
fn window_means(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len().checked_div(width).unwrap_or(0);
    let around = |at: usize, count: usize| at.saturating_sub(HALF_WINDOW)..(at + HALF_WINDOW + 1).min(count);
    let mut along = Vec::with_capacity(values.len());
    for row in values.chunks_exact(width.max(1)) {
        along.extend((0..width).map(|column| {
            let window = &row[around(column, width)];
            window.iter().sum::<f64>() / window.len() as f64
        }));
    }
    let mut means = Vec::with_capacity(values.len());
    for row in 0..height {
        let rows = around(row, height);
        let count = rows.len() as f64;
        means.extend((0..width).map(|column| {
            let sum: f64 = rows.clone().map(|row| along[row * width + column]).sum();
            sum / count
        }));
    }
    means
}

/// What all pairs say of each pixel.
struct Votes {
    moved: u32,
    /// Pairs in which both windows have texture, and in which they then agree.
    textured: Vec<u32>,
    agree: Vec<u32>,
    /// Pairs in which the gray value stays about the same.
    quiet: Vec<u32>,
}

impl Votes {
    fn new(pixels: usize) -> Self {
        Self {
            moved: 0,
            textured: vec![0; pixels],
            agree: vec![0; pixels],
            quiet: vec![0; pixels],
        }
    }

    /// Adds what a pair says, if the camera has moved between its photos.
    fn add(&mut self, [one, other]: [&Gray; 2], windows: [&Windows; 2], known: &[bool]) {
        let [of_one, of_other] = windows;
        let products: Vec<f64> = one.values.iter().zip(&other.values).map(|(a, b)| a * b).collect();
        let products = window_means(&products, one.width);
        let correlation = |pixel: usize| {
            let (a, b) = (of_one.deviation[pixel], of_other.deviation[pixel]);
            let covariance = products[pixel] - of_one.mean[pixel] * of_other.mean[pixel];
            (a >= TEXTURE && b >= TEXTURE && !known[pixel]).then(|| {
                if a.max(b) <= CONTRAST * a.min(b) {
                    covariance / (a * b)
                } else {
                    0.0
                }
            })
        };
        let correlations: Vec<Option<f64>> = (0..products.len()).map(correlation).collect();
        let textured = correlations.iter().flatten().count();
        let differ = correlations
            .iter()
            .flatten()
            .filter(|value| **value < DIFFER)
            .count();
        if textured == 0 || (differ as f64) < MOVED_SHARE * textured as f64 {
            return;
        }
        self.moved += 1;
        // Other exposure or light, as the pixels that agree have it.
        let offsets = correlations
            .iter()
            .enumerate()
            .filter(|(_, value)| value.is_some_and(|value| value >= AGREE));
        let offsets = offsets.map(|(pixel, _)| other.values[pixel] - one.values[pixel]);
        let offset = lower_median(offsets).unwrap_or(0.0);
        for (pixel, correlation) in correlations.iter().enumerate() {
            self.textured[pixel] += u32::from(correlation.is_some());
            self.agree[pixel] += u32::from(correlation.is_some_and(|value| value >= AGREE));
            let difference = other.values[pixel] - one.values[pixel] - offset;
            self.quiet[pixel] += u32::from(difference.abs() <= QUIET);
        }
    }

    /// Returns the stationary region: edges that agree, closed, with the area they enclose and without specks.
    fn region(&self, width: usize, known: &[bool]) -> Vec<bool> {
        let height = self.agree.len() / width.max(1);
        let of_pairs = |votes: u32, pairs: u32, share: f64| f64::from(votes) >= share * f64::from(pairs);
        let edges = (0..self.agree.len()).map(|pixel| {
            self.textured[pixel] >= LEAST_PAIRS
                && of_pairs(self.agree[pixel], self.textured[pixel], STATIONARY_SHARE)
        });
        let quiet = self
            .quiet
            .iter()
            .map(|quiet| of_pairs(*quiet, self.moved, STATIONARY_SHARE))
            .collect::<Vec<_>>();
        let reach = (CLOSED_SHARE * width.max(height) as f64).round().max(1.0) as usize;
        let edges: Vec<bool> = edges.collect();
        let mut region = without(&closed(&edges, width, reach), width, |part| {
            (part.len() as f64) < LEAST_PART * self.agree.len() as f64
        });
        if region.contains(&true) {
            let rest: Vec<bool> = region.iter().map(|is_in| !is_in).collect();
            let changing = without(&rest, width, |part| {
                let still = part.iter().filter(|pixel| quiet[**pixel]).count();
                still as f64 >= QUIET_SHARE * part.len() as f64
            });
            region = changing.iter().map(|is_in| !is_in).collect();
        }
        region
            .iter()
            .zip(known)
            .map(|(is_in, known)| *is_in && !known)
            .collect()
    }
}

/// Closes gaps of up to twice `reach` pixels by squares: grown, then shrunk. What lies outside the picture counts as inside when it
/// is shrunk, so that a part at the edge stays there.
fn closed(is_in: &[bool], width: usize, reach: usize) -> Vec<bool> {
    let shrunk = |grown: &[bool]| {
        let outside: Vec<bool> = grown.iter().map(|is_in| !is_in).collect();
        let outside = grown_by(&outside, width, reach);
        outside.iter().map(|is_out| !is_out).collect()
    };
    shrunk(&grown_by(is_in, width, reach))
}

/// Returns the pixels within `reach` columns and rows of one that is in.
pub(crate) fn grown_by(is_in: &[bool], width: usize, reach: usize) -> Vec<bool> {
    let height = is_in.len().checked_div(width).unwrap_or(0);
    let around = |at: usize, count: usize| at.saturating_sub(reach)..(at + reach + 1).min(count);
    let along: Vec<bool> = is_in
        .chunks_exact(width.max(1))
        .flat_map(|row| (0..width).map(move |column| row[around(column, width)].contains(&true)))
        .collect();
    let pixel = |row: usize, column: usize| around(row, height).any(|row| along[row * width + column]);
    (0..height)
        .flat_map(|row| (0..width).map(move |column| (row, column)))
        .map(|(row, column)| pixel(row, column))
        .collect()
}

/// Returns the pixels that are in, without the connected parts (by sides) that are dropped.
fn without(is_in: &[bool], width: usize, is_dropped: impl Fn(&[usize]) -> bool) -> Vec<bool> {
    let mut kept = is_in.to_vec();
    visit_parts(
        is_in,
        width,
        |_, _| true,
        |part| {
            if is_dropped(part) {
                part.iter().for_each(|pixel| kept[*pixel] = false);
            }
        },
    );
    kept
}

#[cfg(test)]
mod tests;
