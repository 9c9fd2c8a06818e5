use std::collections::VecDeque;

use super::comparable::{Hidden, MetricError, check};
use crate::{Image, Srgb};

/// Pixels on each side of a window of [`ssim`].
const RADIUS: usize = 5;
/// Pixels a side of a window of [`ssim`], and of the smallest image it accepts.
const WINDOW: usize = 2 * RADIUS + 1;
/// exp(-i² / (2 · 1.5²)) for i = -5..=5, divided by the sum. It is a table because `exp` differs between libms.
const GAUSSIAN: [f64; WINDOW] = [
    0.001_028_380_084_479_109_2,
    0.007_598_758_135_239_185,
    0.036_000_772_128_430_83,
    0.109_360_689_509_700_02,
    0.213_005_537_711_253_7,
    0.266_011_724_861_794_36,
    0.213_005_537_711_253_7,
    0.109_360_689_509_700_02,
    0.036_000_772_128_430_83,
    0.007_598_758_135_239_185,
    0.001_028_380_084_479_109_2,
];

/// Returns the mean structural similarity of two images, 1 for equal ones, at least -1.
///
/// SSIM with Gaussian windows of σ = 1.5 px cut at 11 x 11, K1 = 0.01, K2 = 0.03, population covariance and data range 1, per channel on
/// sRGB values in [0, 1]. The mean is over channels and the windows inside the image without a hidden pixel.
///
/// Source: Wang et al. 2004, and scikit-image `structural_similarity` with `gaussian_weights=True, sigma=1.5, use_sample_covariance=False`.
/// Sums run in one fixed order.
///
/// # Errors
/// Images of different size or smaller than one window, or no window without a hidden pixel.
pub fn ssim(a: &Image<Srgb>, b: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    check(a, b, WINDOW as u32)?;
    let windows = OpenWindows::new(a.width as usize, a.height as usize, hidden);
    if windows.count == 0 {
        return Err(MetricError::Hidden);
    }
    let mean = (0..3)
        .map(|channel| ssim_channel(a, b, channel, &windows))
        .sum::<f64>()
        / 3.0;
    Ok(mean)
}

/// Windows of SSIM without a hidden pixel.
struct OpenWindows {
    /// Whether each window, row by row, has no hidden pixel. Empty if no pixel is hidden.
    open: Vec<bool>,
    count: usize,
}

impl OpenWindows {
    fn new(width: usize, height: usize, hidden: Hidden<'_>) -> Self {
        let (columns, rows) = (width - 2 * RADIUS, height - 2 * RADIUS);
        if hidden.is_empty() {
            return Self {
                open: Vec::new(),
                count: columns * rows,
            };
        }
        // Hidden pixels above and left of each corner.
        let mut sums = vec![0_u32; (width + 1) * (height + 1)];
        for row in 0..height {
            let mut in_row = 0;
            for column in 0..width {
                in_row += u32::from(hidden[row * width + column]);
                sums[(row + 1) * (width + 1) + column + 1] = sums[row * (width + 1) + column + 1] + in_row;
            }
        }
        let sum = |row: usize, column: usize| sums[row * (width + 1) + column];
        let is_open = |row: usize, column: usize| {
            let (below, right) = (row + WINDOW, column + WINDOW);
            sum(below, right) + sum(row, column) == sum(row, right) + sum(below, column)
        };
        let open: Vec<bool> = (0..rows)
            .flat_map(|row| (0..columns).map(move |column| (row, column)))
            .map(|(row, column)| is_open(row, column))
            .collect();
        Self {
            count: open.iter().filter(|open| **open).count(),
            open,
        }
    }

    /// Returns those of one row of windows. Empty if all are open.
    fn row(&self, row: usize, columns: usize) -> &[bool] {
        self.open
            .get(row * columns..(row + 1) * columns)
            .unwrap_or_default()
    }
}

/// Weighted means over a window: of a, b, a², b² and a b.
type Moments = [f64; 5];

/// Returns the mean SSIM of one channel.
fn ssim_channel(a: &Image<Srgb>, b: &Image<Srgb>, channel: usize, windows: &OpenWindows) -> f64 {
    let width = a.width as usize;
    let mut done = 0;
    // Only the rows under one window are kept: a whole photo of moments would take 40 bytes a pixel.
    let mut rows = VecDeque::with_capacity(WINDOW);
    let mut sum = 0.0;
    for (a, b) in a.pixels.chunks(width).zip(b.pixels.chunks(width)) {
        if rows.len() == WINDOW {
            rows.pop_front();
        }
        rows.push_back(filter_row(a, b, channel));
        if rows.len() == WINDOW {
            sum += ssim_of_rows(&rows, windows.row(done, width - 2 * RADIUS));
            done += 1;
        }
    }
    sum / windows.count as f64
}

/// Returns the moments along one row, for each window inside it.
fn filter_row(a: &[[u8; 3]], b: &[[u8; 3]], channel: usize) -> Vec<Moments> {
    let products: Vec<Moments> = (a.iter().zip(b))
        .map(|(a, b)| {
            let (a, b) = (f64::from(a[channel]) / 255.0, f64::from(b[channel]) / 255.0);
            [a, b, a * a, b * b, a * b]
        })
        .collect();
    products
        .windows(WINDOW)
        .map(|window| weighted(window.iter()))
        .collect()
}

/// Returns the sum of the SSIM of all open windows that these rows cover. `open` is empty if all are.
fn ssim_of_rows(rows: &VecDeque<Vec<Moments>>, open: &[bool]) -> f64 {
    let columns = rows.front().map_or(0, Vec::len);
    (0..columns)
        .filter(|column| open.get(*column).copied().unwrap_or(true))
        .map(|column| ssim_of(weighted(rows.iter().map(|row| &row[column]))))
        .sum()
}

/// Returns the moments of a window weighted by [`GAUSSIAN`].
fn weighted<'a>(window: impl Iterator<Item = &'a Moments>) -> Moments {
    let mut sums = [0.0; 5];
    for (moments, weight) in window.zip(GAUSSIAN) {
        for (sum, moment) in sums.iter_mut().zip(moments) {
            *sum += weight * moment;
        }
    }
    sums
}

/// Returns the SSIM of one window.
fn ssim_of([a, b, aa, bb, ab]: Moments) -> f64 {
    const C1: f64 = 0.01 * 0.01;
    const C2: f64 = 0.03 * 0.03;
    let covariance = ab - a * b;
    let variances = (aa - a * a) + (bb - b * b);
    ((2.0 * a * b + C1) * (2.0 * covariance + C2)) / ((a * a + b * b + C1) * (variances + C2))
}
