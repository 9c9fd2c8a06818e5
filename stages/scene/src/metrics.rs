//! Image metrics: PSNR (two definitions) and SSIM.

use std::collections::VecDeque;

use crate::{Image, Srgb};

/// Smallest mean squared error that counts, with white = 1: equal images have 100 dB instead of infinity.
const MIN_MSE: f64 = 1e-10;
/// Pixels on each side of a window of [`ssim`].
const RADIUS: usize = 5;
/// Pixels a side of a window of [`ssim`], and of the smallest image it accepts.
const WINDOW: usize = 2 * RADIUS + 1;
/// exp(-i² / (2 · 1.5²)) for i = -5..=5, divided by the sum; written out because `exp` differs between libms.
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

/// Two images that cannot be compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MetricError {
    /// The sizes differ.
    #[error("{} x {} pixels cannot be compared with {} x {}", .a.0, .a.1, .b.0, .b.1)]
    Size {
        /// Width and height of the first image.
        a: (u32, u32),
        /// Width and height of the second one.
        b: (u32, u32),
    },
    /// The images have fewer pixels than the metric needs.
    #[error("{width} x {height} pixels, at least {min} a side are needed")]
    TooSmall {
        /// Width of both.
        width: u32,
        /// Height of both.
        height: u32,
        /// Pixels needed a side.
        min: u32,
    },
    /// All that could be compared is hidden.
    #[error("a mask hides all that could be compared")]
    Hidden,
    /// The photo is black, so [`psnr_paper`] has no peak.
    #[error("the photo is black everywhere: there is no peak to measure against")]
    NoPeak,
}

/// Pixels that a comparison leaves out, `[height * width]`; empty: none.
pub type Hidden<'a> = &'a [bool];

/// Returns the peak signal-to-noise ratio in dB, with white as the peak: 10 log₁₀(1 / MSE), over the pixels that are not hidden.
///
/// MSE is the mean over pixels and channels of the squared difference of 8-bit sRGB values divided by 255. The
/// sum is exact (integers), the logarithm our own: equal images give equal bits on every machine.
///
/// # Extremes
/// Equal images give 100 dB (MSE is held at 1e-10 or more); black against white gives 0 dB.
///
/// # Errors
/// Images of different size or without pixels.
pub fn psnr(a: &Image<Srgb>, b: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    Ok(decibels(1.0 / mean_squared_error(a, b, hidden)?))
}

/// Returns the paper's PSNR in dB, with the photo's largest value as the peak: 10 log₁₀(max(I²) / MSE).
///
/// I is the photo, 8-bit sRGB values divided by 255, the maximum over pixels and channels (MaRF, section
/// "Optimization"). Never above [`psnr`].
///
/// # Errors
/// Images of different size or without pixels; a photo that is black everywhere.
pub fn psnr_paper(render: &Image<Srgb>, photo: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    let mse = mean_squared_error(render, photo, hidden)?;
    let open = open(&photo.pixels, hidden).map(|(_, rgb)| rgb);
    let peak = open.flatten().max().copied().unwrap_or(0);
    if peak == 0 {
        return Err(MetricError::NoPeak);
    }
    let peak = f64::from(peak) / 255.0;
    Ok(decibels(peak * peak / mse))
}

/// Returns the mean structural similarity of two images, 1 for equal ones, at least -1.
///
/// SSIM with Gaussian windows of σ = 1.5 px cut at 11 x 11, K1 = 0.01, K2 = 0.03, population covariance, data
/// range 1, per channel on sRGB values in [0, 1], mean over the windows that lie inside the image and hold no hidden pixel, and over
/// channels (Wang et al. 2004; scikit-image `structural_similarity` with `gaussian_weights=True, sigma=1.5,
/// use_sample_covariance=False`). Sums run in one fixed order.
///
/// # Errors
/// Images of different size or smaller than one window, or no window without a hidden pixel.
pub fn ssim(a: &Image<Srgb>, b: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    check(a, b, WINDOW as u32)?;
    let windows = OpenWindows::of(a.width as usize, a.height as usize, hidden);
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
    /// Of each window, row by row, whether it holds no hidden pixel; empty where none is hidden.
    open: Vec<bool>,
    count: usize,
}

impl OpenWindows {
    fn of(width: usize, height: usize, hidden: Hidden<'_>) -> Self {
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

    /// Returns those of one row of windows; empty where all are open.
    fn row(&self, row: usize, columns: usize) -> &[bool] {
        self.open
            .get(row * columns..(row + 1) * columns)
            .unwrap_or_default()
    }
}

/// Checks that two images have the same size, and at least `min` pixels a side.
fn check(a: &Image<Srgb>, b: &Image<Srgb>, min: u32) -> Result<(), MetricError> {
    let (width, height) = (a.width, a.height);
    if (width, height) != (b.width, b.height) {
        let b = (b.width, b.height);
        return Err(MetricError::Size {
            a: (width, height),
            b,
        });
    }
    if width < min || height < min {
        return Err(MetricError::TooSmall { width, height, min });
    }
    Ok(())
}

/// Returns the mean squared error with white = 1, at least [`MIN_MSE`].
fn mean_squared_error(a: &Image<Srgb>, b: &Image<Srgb>, hidden: Hidden<'_>) -> Result<f64, MetricError> {
    check(a, b, 1)?;
    let square = |(a, b): (&u8, &u8)| u64::from(a.abs_diff(*b)).pow(2);
    let (mut sum, mut count) = (0_u64, 0_u64);
    for (index, a) in open(&a.pixels, hidden) {
        sum += a.iter().zip(&b.pixels[index]).map(square).sum::<u64>();
        count += 3;
    }
    if count == 0 {
        return Err(MetricError::Hidden);
    }
    Ok((sum as f64 / (count as f64 * 65_025.0)).max(MIN_MSE))
}

/// Returns the pixels that are not hidden, with their places.
fn open<'a>(pixels: &'a [[u8; 3]], hidden: Hidden<'a>) -> impl Iterator<Item = (usize, &'a [u8; 3])> {
    let is_open = |(index, _): &(usize, &[u8; 3])| !hidden.get(*index).copied().unwrap_or(false);
    pixels.iter().enumerate().filter(is_open)
}

/// Returns a ratio of powers in decibels.
fn decibels(ratio: f64) -> f64 {
    10.0 * ln(ratio) * std::f64::consts::LOG10_E
}

/// Returns the natural logarithm of a positive normal number within 2 ulp, from + - * / alone.
///
/// x = m 2ᵉ with m in [√½, √2); ln m = 2 artanh(s), s = (m - 1) / (m + 1), |s| <= 0.172: the first dropped
/// term is s²⁴ / 25 < 2e-20.
pub(crate) fn ln(x: f64) -> f64 {
    let bits = x.to_bits();
    let mut exponent = (bits >> 52) as i64 - 1023;
    let mut mantissa = f64::from_bits((bits & 0x000f_ffff_ffff_ffff) | 0x3ff0_0000_0000_0000);
    if mantissa > std::f64::consts::SQRT_2 {
        mantissa /= 2.0;
        exponent += 1;
    }
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let series = (0..12)
        .rev()
        .fold(0.0, |sum, k| sum * s * s + 1.0 / f64::from(2 * k + 1));
    exponent as f64 * std::f64::consts::LN_2 + 2.0 * s * series
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

/// Returns the moments along one row, for each window that lies inside it.
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

/// Returns the sum of the SSIM of all open windows that these rows cover; `open` is empty where all are.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// scikit-image and this file may differ by rounding only.
    const SSIM_TOLERANCE: f64 = 1e-9;

    fn flat(value: u8) -> Image<Srgb> {
        Image::from_fn(16, 12, |_, _| [value; 3])
    }

    /// Returns two images by formulas; scikit-image computed the expected values on the same formulas.
    fn patterns(width: u32, height: u32) -> (Image<Srgb>, Image<Srgb>) {
        let a = Image::from_fn(width, height, |x, y| {
            [(x * 7 + y * 3) % 256, (x * x + y) % 256, (x * y) % 256].map(|v| v as u8)
        });
        let b = Image::from_fn(width, height, |x, y| {
            [
                (x * 7 + y * 3 + 5) % 256,
                (x * x + 2 * y) % 256,
                (x * y + x) % 256,
            ]
            .map(|v| v as u8)
        });
        (a, b)
    }

    #[test]
    fn psnr_of_one_grey_step_is_48_decibels() {
        // MSE = (1 / 255)²: 20 log10(255).
        let psnr = psnr(&flat(100), &flat(101), &[]).unwrap();
        assert!((psnr - 48.130_803_608_679_1).abs() < 1e-12, "{psnr}");
    }

    #[test]
    fn psnr_runs_from_0_for_opposites_to_100_for_equals() {
        assert_eq!(psnr(&flat(0), &flat(255), &[]).unwrap(), 0.0);
        let equal = psnr(&flat(9), &flat(9), &[]).unwrap();
        assert!((equal - 100.0).abs() < 1e-12, "{equal}");
    }

    #[test]
    fn the_papers_psnr_measures_against_the_brightest_value_of_the_photo() {
        // max = 51 / 255 = 0.2: 20 log10(51) instead of 20 log10(255).
        let dark = psnr_paper(&flat(50), &flat(51), &[]).unwrap();
        assert!((dark - 34.151_403_521_958_73).abs() < 1e-12, "{dark}");
        let bright = psnr_paper(&flat(254), &flat(255), &[]).unwrap();
        assert_eq!(bright, psnr(&flat(254), &flat(255), &[]).unwrap());
        assert_eq!(psnr_paper(&flat(3), &flat(0), &[]), Err(MetricError::NoPeak));
    }

    #[test]
    fn our_logarithm_is_the_libms() {
        for x in [
            1e-300, 1e-10, 0.5, 0.707, 0.7072, 1.0, 1.414, 1.415, 2.0, 255.0, 1e10, 1e300,
        ] {
            let (ours, theirs) = (ln(x), f64::ln(x));
            assert!(
                (ours - theirs).abs() <= 4e-16 * theirs.abs(),
                "{x}: {ours} {theirs}"
            );
        }
    }

    /// Of scikit-image 0.26 on [`patterns`]: size, `structural_similarity`, `peak_signal_noise_ratio`.
    const SCIKIT_IMAGE: [((u32, u32), f64, f64); 7] = [
        ((11, 11), 0.985_936_185_859_638_4, 33.124_780_102_987_25),
        ((12, 11), 0.987_158_381_785_562_8, 32.808_923_914_528_016),
        ((37, 29), 0.768_714_590_906_962_3, 14.666_531_889_766_592),
        ((11, 64), 0.946_829_376_784_194_1, 19.013_821_381_945_238),
        ((65, 33), 0.665_216_876_939_498_3, 12.928_506_544_010_83),
        ((128, 96), 0.355_621_184_786_306, 9.843_095_064_594_849),
        ((301, 203), 0.296_334_513_512_726, 9.302_902_129_241_705),
    ];

    #[test]
    fn ssim_and_psnr_equal_those_of_scikit_image_at_every_size() {
        for (size, ssim_there, psnr_there) in SCIKIT_IMAGE {
            let (a, b) = patterns(size.0, size.1);
            let (ssim, psnr) = (ssim(&a, &b, &[]).unwrap(), psnr(&a, &b, &[]).unwrap());
            assert!((ssim - ssim_there).abs() < SSIM_TOLERANCE, "{size:?}: {ssim}");
            assert!((psnr - psnr_there).abs() < 1e-9, "{size:?}: {psnr}");
        }
    }

    #[test]
    fn ssim_with_a_flat_image_equals_scikit_images() {
        for (other, expected) in [
            (flat(103), 0.999_563_435_332_282_9),
            (patterns(16, 12).0, 0.176_709_722_131_038_17),
        ] {
            let ssim = ssim(&flat(100), &other, &[]).unwrap();
            assert!((ssim - expected).abs() < SSIM_TOLERANCE, "{ssim} {expected}");
        }
    }

    #[test]
    fn ssim_of_flat_images_is_the_luminance_term() {
        // a = 0, b = 1: (0 + C1)(0 + C2) / ((1 + C1)(0 + C2)) = 1e-4 / 1.0001.
        let ssim = ssim(&flat(0), &flat(255), &[]).unwrap();
        assert!((ssim - 1e-4 / 1.0001).abs() < 1e-9, "{ssim}");
    }

    #[test]
    fn ssim_is_symmetric_and_1_for_equals() {
        let (a, b) = patterns(20, 15);
        assert_eq!(ssim(&a, &b, &[]), ssim(&b, &a, &[]));
        let equal = ssim(&a, &a, &[]).unwrap();
        assert!((equal - 1.0).abs() < 1e-12, "{equal}");
    }

    #[test]
    fn sizes_that_differ_or_are_too_small_are_named() {
        let error = psnr(&flat(0), &patterns(16, 13).0, &[]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "16 x 12 pixels cannot be compared with 16 x 13"
        );
        let (a, b) = patterns(10, 40);
        let error = ssim(&a, &b, &[]).unwrap_err();
        assert_eq!(error.to_string(), "10 x 40 pixels, at least 11 a side are needed");
        let (a, b) = patterns(0, 0);
        assert!(matches!(psnr(&a, &b, &[]), Err(MetricError::TooSmall { .. })));
    }

    fn real(name: &str) -> Option<Image<Srgb>> {
        let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
        let data = std::env::var("MARF_SHARED_DATA").unwrap_or_else(|_| data.to_owned());
        let bytes = std::fs::read(format!("{data}/{name}")).ok()?;
        Some(crate::Photo::decode(&bytes).unwrap().image)
    }

    #[test]
    fn real_photos_score_as_in_scikit_image() {
        let pairs = [
            (
                "rover4/images/frame_0000{}.png",
                ["3", "6"],
                17.822_650_611_055_26,
                0.412_328_459_104_695_2,
            ),
            (
                "fox4/images/000{}.png",
                ["1", "2"],
                19.130_840_489_622_727,
                0.450_064_433_734_451_4,
            ),
        ];
        for (name, [a, b], psnr_there, ssim_there) in pairs {
            let (Some(a), Some(b)) = (real(&name.replace("{}", a)), real(&name.replace("{}", b))) else {
                println!("skipped: real_photos_score_as_in_scikit_image needs ../shared/data");
                return;
            };
            let (psnr, ssim) = (psnr(&a, &b, &[]).unwrap(), ssim(&a, &b, &[]).unwrap());
            assert!((psnr - psnr_there).abs() < 1e-9, "{name}: {psnr}");
            assert!((ssim - ssim_there).abs() < SSIM_TOLERANCE, "{name}: {ssim}");
        }
    }

    #[test]
    fn what_is_hidden_changes_nothing_and_all_hidden_is_an_error() {
        let (a, b) = patterns(40, 30);
        let hidden: Vec<bool> = (0..40 * 30).map(|place| place % 40 < 8).collect();
        let mut spoilt = b.clone();
        for (pixel, hidden) in spoilt.pixels.iter_mut().zip(&hidden) {
            if *hidden {
                *pixel = [255, 0, 255];
            }
        }
        assert_ne!(psnr(&a, &b, &[]), psnr(&a, &spoilt, &[]));
        assert_eq!(psnr(&a, &b, &hidden), psnr(&a, &spoilt, &hidden));
        assert_eq!(psnr_paper(&a, &b, &hidden), psnr_paper(&a, &spoilt, &hidden));
        assert_eq!(ssim(&a, &b, &hidden), ssim(&a, &spoilt, &hidden));
        // What is left of the columns is a picture of its own.
        let right = |image: &Image<Srgb>| Image::from_fn(32, 30, |column, row| image.at(column + 8, row));
        assert_eq!(psnr(&a, &b, &hidden), psnr(&right(&a), &right(&b), &[]));
        let (found, expected) = (
            ssim(&a, &b, &hidden).unwrap(),
            ssim(&right(&a), &right(&b), &[]).unwrap(),
        );
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        assert_eq!(psnr(&a, &b, &[true; 1200]), Err(MetricError::Hidden));
        assert_eq!(ssim(&a, &b, &[true; 1200]), Err(MetricError::Hidden));
    }

    #[test]
    fn nothing_hidden_gives_the_same_bits_as_no_mask() {
        let (a, b) = patterns(25, 19);
        let none = [false; 25 * 19];
        assert_eq!(psnr(&a, &b, &none), psnr(&a, &b, &[]));
        assert_eq!(ssim(&a, &b, &none), ssim(&a, &b, &[]));
    }
}
