//! Gaussian scale space, one octave at a time.

use super::gray::Gray;
use crate::simd::{self, InstructionSet, Kernel, Lanes};

/// Layers of an octave in which extrema are searched.
pub(super) const LAYERS: usize = 3;
/// Blur of the first layer, and the blur that a photo is assumed to have, pixels.
pub(super) const SIGMA: f64 = 1.6;
const CAMERA_SIGMA: f64 = 0.5;
/// Shortest side of an octave: the widest descriptor covers more than that.
const SMALLEST: usize = 16;
/// Photos above are not doubled: six layers of 8 megapixels take 192 MB.
const MOST_DOUBLED: usize = 2_000_000;

/// Size at which the search for features begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FirstOctave {
    /// The photo's own.
    Native,
    /// Twice the photo's, for photos up to 2 megapixels. Larger ones keep their own.
    Doubled,
}

/// Size of an octave and position of its pixels in the photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OctaveGrid {
    pub width: usize,
    pub height: usize,
    /// Distance of two pixels, and centre of the first one, pixels of the working size.
    pub step_px: f32,
    pub origin_px: f32,
}

impl OctaveGrid {
    /// Returns the position in the photo of a position in the octave.
    pub(super) fn position_px(&self, x: f32, y: f32) -> [f32; 2] {
        [x, y].map(|at| self.origin_px + self.step_px * at)
    }
}

/// Six Gaussian layers of an octave: layer i has a blur of 1.6 · 2^(i / 3) of its pixels.
pub(super) struct ScaleSpace {
    pub grid: OctaveGrid,
    pub layers: [Vec<f32>; LAYERS + 3],
}

impl ScaleSpace {
    /// Blurs the photo to the first layer of the first octave.
    pub(super) fn new(set: InstructionSet, gray: &Gray, first: FirstOctave) -> Self {
        let (width, height) = (gray.width as usize, gray.height as usize);
        let mut scale_space = Self {
            grid: OctaveGrid {
                width,
                height,
                step_px: 1.0,
                origin_px: 0.5,
            },
            layers: Default::default(),
        };
        if first == FirstOctave::Native || gray.pixels.len() > MOST_DOUBLED || gray.pixels.is_empty() {
            blur(
                set,
                &gray.pixels,
                &mut scale_space.layers[0],
                width,
                kernel(CAMERA_SIGMA, SIGMA),
            );
            return scale_space;
        }
        let doubled = double(gray);
        scale_space.grid = OctaveGrid {
            width: 2 * width,
            height: 2 * height,
            step_px: 0.5,
            origin_px: 0.25,
        };
        blur(
            set,
            &doubled,
            &mut scale_space.layers[0],
            2 * width,
            kernel(2.0 * CAMERA_SIGMA, SIGMA),
        );
        scale_space
    }

    /// Whether this octave is large enough to hold a feature.
    pub(super) fn is_large(&self) -> bool {
        self.grid.width.min(self.grid.height) >= SMALLEST
    }

    /// Computes the layers after the first.
    pub(super) fn fill(&mut self, set: InstructionSet) {
        for layer in 1..self.layers.len() {
            let sigma = |layer: usize| SIGMA * libm::exp2(layer as f64 / LAYERS as f64);
            let weights = kernel(sigma(layer - 1), sigma(layer));
            let (done, rest) = self.layers.split_at_mut(layer);
            blur(set, &done[layer - 1], &mut rest[0], self.grid.width, weights);
        }
    }

    /// Starts the next octave from every second pixel of the layer of twice the blur. Returns the three inner layers.
    pub(super) fn halve(&mut self) -> [Vec<f32>; LAYERS] {
        let old = self.grid;
        self.grid = OctaveGrid {
            width: old.width.div_ceil(2),
            height: old.height.div_ceil(2),
            step_px: 2.0 * old.step_px,
            ..old
        };
        let [base, one, two, three, ..] = &mut self.layers;
        base.clear();
        for row in three.chunks_exact(old.width).step_by(2) {
            base.extend(row.iter().step_by(2));
        }
        [one, two, three].map(std::mem::take)
    }
}

/// Returns the weights of the Gaussian that raises one blur to another, from the middle outwards, cut at 4 standard
/// deviations. The whole kernel sums to 1.
fn kernel(from: f64, to: f64) -> Vec<f32> {
    let variance = to * to - from * from;
    let radius = (4.0 * variance.sqrt()).ceil() as usize;
    let raw: Vec<f64> = (0..=radius)
        .map(|at| libm::exp(-0.5 * (at * at) as f64 / variance))
        .collect();
    let sum = 2.0 * raw.iter().sum::<f64>() - raw[0];
    raw.iter().map(|weight| (weight / sum) as f32).collect()
}

/// Doubles width and height by linear interpolation. Pixel i of the result is at (i + 0.5) / 2 px.
fn double(gray: &Gray) -> Vec<f32> {
    let (width, height) = (gray.width as usize, gray.height as usize);
    // The nearer neighbour weighs 3/4. Edges are repeated.
    let near = |at: usize, len: usize| {
        let other = if at.is_multiple_of(2) {
            (at / 2).saturating_sub(1)
        } else {
            (at / 2 + 1).min(len - 1)
        };
        (at / 2, other)
    };
    let mut doubled = Vec::with_capacity(4 * gray.pixels.len());
    let mut line = vec![0.0; width];
    for row in 0..2 * height {
        let (near_row, other_row) = near(row, height);
        let rows = gray.pixels[near_row * width..]
            .iter()
            .zip(&gray.pixels[other_row * width..]);
        line.iter_mut()
            .zip(rows)
            .for_each(|(to, (near, other))| *to = 0.75 * near + 0.25 * other);
        doubled.extend((0..2 * width).map(|column| {
            let (near, other) = near(column, width);
            0.75 * line[near] + 0.25 * line[other]
        }));
    }
    doubled
}

/// Blurs rows and columns. Edges are repeated.
fn blur(set: InstructionSet, from: &[f32], to: &mut Vec<f32>, width: usize, weights: Vec<f32>) {
    to.truncate(from.len());
    if to.len() < from.len() {
        // Fresh zeros come from the system without being written.
        *to = vec![0.0; from.len()];
    }
    if !from.is_empty() {
        simd::run(
            set,
            Blur {
                from,
                to,
                width,
                weights,
            },
        );
    }
}

/// A separable blur as a kernel.
struct Blur<'a> {
    from: &'a [f32],
    to: &'a mut [f32],
    width: usize,
    weights: Vec<f32>,
}

impl Kernel for Blur<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let (width, radius) = (self.width, self.weights.len() - 1);
        let last = self.from.len() / width - 1;
        let mut line = vec![0.0; width + 2 * radius];
        for (y, to) in self.to.chunks_exact_mut(width).enumerate() {
            let row = |y: usize| &self.from[y * width..][..width];
            let pairs = (1..=radius)
                .map(|by| (row(y.saturating_sub(by)), row((y + by).min(last))))
                .collect();
            weigh(&mut line[radius..][..width], row(y), pairs, &self.weights);
            let (left, right) = (line[radius], line[radius + width - 1]);
            line[..radius].fill(left);
            line[radius + width..].fill(right);
            let pairs = (1..=radius)
                .map(|by| (&line[radius - by..], &line[radius + by..]))
                .collect();
            weigh(to, &line[radius..], pairs, &self.weights);
        }
    }
}

/// Sets `to` to the weighted sum of a row and the pairs of rows on both sides of it.
#[inline(always)]
fn weigh(to: &mut [f32], middle: &[f32], pairs: Vec<(&[f32], &[f32])>, weights: &[f32]) {
    let mut at = 0;
    while let Some(to) = to[at..].first_chunk_mut() {
        *to = strip::<64>(at, middle, &pairs, weights);
        at += 64;
    }
    while let Some(to) = to[at..].first_chunk_mut() {
        *to = strip::<16>(at, middle, &pairs, weights);
        at += 16;
    }
    while let Some(to) = to[at..].first_chunk_mut() {
        *to = strip::<1>(at, middle, &pairs, weights);
        at += 1;
    }
}

/// Returns `N` neighbouring weighted sums, which stay in registers.
#[inline(always)]
fn strip<const N: usize>(at: usize, middle: &[f32], pairs: &[(&[f32], &[f32])], weights: &[f32]) -> [f32; N] {
    let cut = |from: &[f32]| -> [f32; N] { std::array::from_fn(|lane| from[at..][..N][lane]) };
    let mut sums = cut(middle).map(|pixel| weights[0] * pixel);
    for (&(before, after), &weight) in pairs.iter().zip(&weights[1..]) {
        let (before, after) = (cut(before), cut(after));
        for lane in 0..N {
            sums[lane] += weight * (before[lane] + after[lane]);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(width: usize, height: usize) -> Gray {
        let mut rng = marf_numeric::Rng::new(11);
        Gray {
            width: width as u32,
            height: height as u32,
            pixels: (0..width * height).map(|_| rng.unit_f64() as f32).collect(),
        }
    }

    #[test]
    fn a_blurred_point_has_the_variance_it_should() {
        let mut point = vec![0.0; 101 * 101];
        point[50 * 101 + 50] = 1.0;
        let mut blurred = Vec::new();
        blur(
            InstructionSet::best(),
            &point,
            &mut blurred,
            101,
            kernel(1.6, 3.2),
        );
        let sum: f64 = blurred.iter().map(|&pixel| f64::from(pixel)).sum();
        let spread = |index: usize, pixel: f32| (index as f64 % 101.0 - 50.0).powi(2) * f64::from(pixel);
        let variance: f64 = blurred
            .iter()
            .enumerate()
            .map(|(index, &pixel)| spread(index, pixel))
            .sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        // Cut at 4 deviations: 0.1 % of the variance is missing.
        assert!((variance - (3.2 * 3.2 - 1.6 * 1.6)).abs() < 0.02, "{variance}");
    }

    #[test]
    fn a_constant_stays_constant_at_every_size() {
        for (width, height) in [(1, 1), (2, 3), (31, 31), (65, 17), (80, 1)] {
            let mut blurred = Vec::new();
            blur(
                InstructionSet::best(),
                &vec![0.5; width * height],
                &mut blurred,
                width,
                kernel(0.5, 1.6),
            );
            assert!(
                blurred.iter().all(|pixel| (pixel - 0.5).abs() < 1e-6),
                "{width} x {height}"
            );
        }
    }

    #[test]
    fn layers_are_equal_to_the_bit_on_every_set() {
        for first in [FirstOctave::Native, FirstOctave::Doubled] {
            let layers = |set| {
                let mut scale_space = ScaleSpace::new(set, &noise(83, 47), first);
                scale_space.fill(set);
                scale_space.layers
            };
            let plain = layers(InstructionSet::all()[0]);
            assert!(InstructionSet::all().into_iter().all(|set| layers(set) == plain));
        }
    }

    #[test]
    fn octaves_keep_the_place_of_the_first_pixel() {
        let set = InstructionSet::best();
        // A ramp of x: the value shows the position.
        let ramp = Gray {
            width: 128,
            height: 64,
            pixels: (0..128 * 64).map(|index| (index % 128) as f32 / 128.0).collect(),
        };
        for first in [FirstOctave::Native, FirstOctave::Doubled] {
            let mut scale_space = ScaleSpace::new(set, &ramp, first);
            for _ in 0..2 {
                scale_space.fill(set);
                scale_space.halve();
            }
            let OctaveGrid {
                width,
                height,
                step_px,
                origin_px,
            } = scale_space.grid;
            assert_eq!(width * height, scale_space.layers[0].len());
            let at = (height / 2) * width + width / 2;
            let x_px = scale_space.layers[0][at] * 128.0 + 0.5;
            assert!(
                (x_px - (origin_px + step_px * (width / 2) as f32)).abs() < 0.01,
                "{x_px}"
            );
        }
    }

    #[test]
    fn a_photo_above_two_megapixels_is_not_doubled() {
        for (width, step_px) in [(1000, 0.5), (1001, 1.0)] {
            let gray = Gray {
                width,
                height: 2000,
                pixels: vec![0.5; width as usize * 2000],
            };
            let scale_space = ScaleSpace::new(InstructionSet::best(), &gray, FirstOctave::Doubled);
            assert_eq!(scale_space.grid.step_px, step_px, "{width}");
        }
    }
}
