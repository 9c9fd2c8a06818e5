//! Extrema of the difference of Gaussians in scale space.

use nalgebra::{Matrix3, Vector3};

use super::pyramid::{LAYERS, SIGMA, ScaleSpace};
use crate::simd::{self, InstructionSet, Kernel, Lanes};

/// An extremum in pixels of its octave. (0, 0) is the centre of the first pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extremum {
    /// Inner layer, from 0, row and column of the nearest sample.
    pub cell: [usize; 3],
    pub x: f32,
    pub y: f32,
    pub sigma: f32,
    /// Absolute difference of Gaussians, interpolated.
    pub response: f32,
}

/// Largest ratio of the two principal curvatures at a keypoint (Lowe 2004, section 4.1; COLMAP).
const EDGE_RATIO: f64 = 10.0;
/// Iterations of the quadratic fit.
const STEPS: usize = 5;
/// An offset larger than this moves the fit to the next sample. It is above 1/2, so that the fit does not alternate
/// between two.
const REACH: f64 = 0.6;
/// Largest offset accepted in the last iteration, and between layers: 3 % more right matches than with [`REACH`].
const LAST_REACH: f64 = 1.0;

/// Returns the extrema of an octave of at least this contrast, sorted by layer, row and column.
pub(super) fn find(set: InstructionSet, scale_space: &ScaleSpace, contrast: f32) -> Vec<Extremum> {
    let candidates = simd::run(
        set,
        CandidateScan {
            scale_space,
            // The fit raises the response, hardly by more than a quarter.
            threshold: 0.8 * contrast,
        },
    );
    let volume = DogVolume { scale_space };
    let strict = candidates.into_iter().filter(|&cell| volume.is_strict(cell));
    let mut found: Vec<Extremum> = strict.filter_map(|cell| volume.fit(cell, contrast)).collect();
    found.sort_by_key(|point| point.cell);
    found.dedup_by_key(|point| point.cell);
    found
}

/// Finds the samples that are not below (above) any of their 26 neighbours, row by row.
struct CandidateScan<'a> {
    scale_space: &'a ScaleSpace,
    threshold: f32,
}

/// Three rows of one difference of Gaussians, and the maxima and minima over 3 x 3 samples around the middle row.
#[derive(Default)]
struct DogRows {
    /// Row y is at y % 3.
    ring: [Vec<f32>; 3],
    down: Vec<f32>,
    greatest: Vec<f32>,
    least: Vec<f32>,
}

impl Kernel for CandidateScan<'_> {
    type Output = Vec<[usize; 3]>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        let (width, height) = (self.scale_space.grid.width, self.scale_space.grid.height);
        let mut differences: [DogRows; LAYERS + 2] = Default::default();
        let mut flags = vec![0_u8; width];
        let mut found = Vec::new();
        for y in 0..height {
            for (rows, layers) in differences.iter_mut().zip(self.scale_space.layers.windows(2)) {
                let row = |layer: usize| &layers[layer][y * width..][..width];
                rows.push(y, row(0), row(1));
            }
            for (layer, three) in differences.windows(3).enumerate().filter(|_| y >= 2) {
                let middle = &three[1].ring[(y - 1) % 3];
                mark(
                    &mut flags,
                    [&three[0], &three[1], &three[2]],
                    middle,
                    self.threshold,
                );
                collect(&flags, |column| found.push([layer, y - 1, column]));
            }
        }
        found
    }
}

impl DogRows {
    /// Adds the next row. From the third on the maxima and minima are those around the row before.
    #[inline(always)]
    fn push(&mut self, y: usize, below: &[f32], above: &[f32]) {
        let next = &mut self.ring[y % 3];
        next.resize(above.len(), 0.0);
        for (to, (above, below)) in next.iter_mut().zip(above.iter().zip(below)) {
            *to = above - below;
        }
        if y >= 2 {
            fold(&mut self.greatest, &mut self.down, &self.ring, |a, b| {
                if a > b { a } else { b }
            });
            fold(&mut self.least, &mut self.down, &self.ring, |a, b| {
                if a < b { a } else { b }
            });
        }
    }
}

/// Reduces 3 x 3 samples to one, columns first. The first and the last column are not set.
#[inline(always)]
fn fold(to: &mut Vec<f32>, down: &mut Vec<f32>, rows: &[Vec<f32>; 3], of: impl Fn(f32, f32) -> f32) {
    let len = rows[0].len();
    let [a, b, c] = [&rows[0][..len], &rows[1][..len], &rows[2][..len]];
    down.resize(len, 0.0);
    to.resize(len, 0.0);
    for (x, down) in down.iter_mut().enumerate() {
        *down = of(of(a[x], b[x]), c[x]);
    }
    let (left, middle, right) = (&down[..len - 2], &down[1..len - 1], &down[2..]);
    for (x, to) in to[1..len - 1].iter_mut().enumerate() {
        *to = of(of(left[x], middle[x]), right[x]);
    }
}

/// Flags the columns whose middle is an extremum of 27 samples and beyond the threshold.
#[inline(always)]
fn mark(flags: &mut [u8], around: [&DogRows; 3], middle: &[f32], threshold: f32) {
    let len = middle.len();
    let greatest = around.map(|rows| &rows.greatest[..len]);
    let least = around.map(|rows| &rows.least[..len]);
    let flags = &mut flags[..len];
    for x in 1..len - 1 {
        let value = middle[x];
        let top = (value >= greatest[0][x]) & (value >= greatest[1][x]) & (value >= greatest[2][x]);
        let bottom = (value <= least[0][x]) & (value <= least[1][x]) & (value <= least[2][x]);
        flags[x] = u8::from((top & (value > threshold)) | (bottom & (value < -threshold)));
    }
}

/// Calls `found` with the index of every set flag.
#[inline(always)]
fn collect(flags: &[u8], mut found: impl FnMut(usize)) {
    for (index, chunk) in flags.chunks(64).enumerate() {
        if chunk.iter().fold(0, |any, flag| any | flag) == 0 {
            continue;
        }
        let set = chunk.iter().enumerate().filter(|&(_, &flag)| flag != 0);
        set.for_each(|(lane, _)| found(index * 64 + lane));
    }
}

/// The differences of Gaussians of an octave, indexed by layer, row and column.
struct DogVolume<'a> {
    scale_space: &'a ScaleSpace,
}

impl DogVolume<'_> {
    /// Returns the sample at an offset from a cell.
    fn at(&self, [layer, row, column]: [usize; 3], by: [isize; 3]) -> f64 {
        let layer = (layer + 1).wrapping_add_signed(by[0]);
        let index =
            row.wrapping_add_signed(by[1]) * self.scale_space.grid.width + column.wrapping_add_signed(by[2]);
        f64::from(self.scale_space.layers[layer + 1][index])
            - f64::from(self.scale_space.layers[layer][index])
    }

    /// Whether a sample is strictly above (below) all its neighbours. A plateau has no extremum.
    fn is_strict(&self, cell: [usize; 3]) -> bool {
        let value = self.at(cell, [0; 3]);
        let neighbours = (0..27_isize).filter(|&index| index != 13).map(|index| {
            let by = [index / 9 - 1, index / 3 % 3 - 1, index % 3 - 1];
            self.at(cell, by)
        });
        let mut neighbours = neighbours.map(|other| if value > 0.0 { value - other } else { other - value });
        neighbours.all(|lead| lead > 0.0)
    }

    /// Returns the extremum of a quadratic fitted around a sample, moving to a neighbour in its layer where the extremum is
    /// nearer to that.
    fn fit(&self, mut cell: [usize; 3], contrast: f32) -> Option<Extremum> {
        let ends = [
            0,
            self.scale_space.grid.height - 1,
            self.scale_space.grid.width - 1,
        ];
        for step in 1..=STEPS {
            let (slope, curvature) = self.derivatives(cell);
            let offset = -(curvature.try_inverse()? * slope);
            let reach = if step < STEPS { REACH } else { LAST_REACH };
            if offset[1].abs() <= reach && offset[2].abs() <= reach {
                let near = offset[0].abs() < LAST_REACH;
                return near.then(|| self.accept(cell, &offset, &slope, &curvature, contrast))?;
            }
            for axis in [1, 2].into_iter().filter(|&axis| offset[axis].abs() > REACH) {
                cell[axis] = cell[axis].wrapping_add_signed(offset[axis].signum() as isize);
                // A neighbour is needed on both sides.
                if !(1..ends[axis]).contains(&cell[axis]) {
                    return None;
                }
            }
        }
        None
    }

    /// Returns gradient and Hessian along layer, row and column.
    fn derivatives(&self, cell: [usize; 3]) -> (Vector3<f64>, Matrix3<f64>) {
        let unit = |axis: usize, by: isize| -> [isize; 3] {
            std::array::from_fn(|at| if at == axis { by } else { 0 })
        };
        let both = |a: usize, by_a: isize, b: usize, by_b: isize| {
            let (a, b) = (unit(a, by_a), unit(b, by_b));
            self.at(cell, std::array::from_fn(|at| a[at] + b[at]))
        };
        let middle = self.at(cell, [0; 3]);
        let slope =
            Vector3::from_fn(|axis, _| 0.5 * (self.at(cell, unit(axis, 1)) - self.at(cell, unit(axis, -1))));
        let curvature = Matrix3::from_fn(|a, b| {
            if a == b {
                return self.at(cell, unit(a, 1)) + self.at(cell, unit(a, -1)) - 2.0 * middle;
            }
            0.25 * (both(a, 1, b, 1) - both(a, 1, b, -1) - both(a, -1, b, 1) + both(a, -1, b, -1))
        });
        (slope, curvature)
    }

    /// Returns the extremum if its contrast is high enough and it is not on an edge.
    fn accept(
        &self,
        cell: [usize; 3],
        offset: &Vector3<f64>,
        slope: &Vector3<f64>,
        curvature: &Matrix3<f64>,
        contrast: f32,
    ) -> Option<Extremum> {
        let response = (self.at(cell, [0; 3]) + 0.5 * slope.dot(offset)).abs();
        let trace = curvature[(1, 1)] + curvature[(2, 2)];
        let determinant = curvature[(1, 1)] * curvature[(2, 2)] - curvature[(1, 2)] * curvature[(1, 2)];
        // A saddle has a determinant below 0.
        let is_edge = trace * trace * EDGE_RATIO >= (EDGE_RATIO + 1.0) * (EDGE_RATIO + 1.0) * determinant;
        let [layer, row, column] = cell;
        let sigma = SIGMA * libm::exp2((layer as f64 + 1.0 + offset[0]) / LAYERS as f64);
        let strong = response > f64::from(contrast);
        (strong && !is_edge).then_some(Extremum {
            cell,
            x: (column as f64 + offset[2]) as f32,
            y: (row as f64 + offset[1]) as f32,
            sigma: sigma as f32,
            response: response as f32,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::extract::CONTRAST;
    use super::super::gray::Gray;
    use super::super::pyramid::FirstOctave;
    use super::*;

    /// A Gaussian blob on grey.
    fn blob(x_px: f64, y_px: f64, sigma_px: f64, height: f64) -> Gray {
        let pixel = |index: u32| {
            let (x, y) = (
                f64::from(index % 80) + 0.5 - x_px,
                f64::from(index / 80) + 0.5 - y_px,
            );
            (0.5 + height * (-0.5 * (x * x + y * y) / (sigma_px * sigma_px)).exp()) as f32
        };
        Gray {
            width: 80,
            height: 60,
            pixels: (0..80 * 60).map(pixel).collect(),
        }
    }

    fn found(set: InstructionSet, gray: &Gray) -> Vec<Extremum> {
        let mut scale_space = ScaleSpace::new(set, gray, FirstOctave::Native);
        scale_space.fill(set);
        find(set, &scale_space, CONTRAST)
    }

    #[test]
    fn a_blob_is_found_once_where_it_stands_and_as_large_as_it_is() {
        for (x_px, y_px, sigma_px) in [(40.5, 30.5, 2.5), (33.2, 28.9, 2.2), (40.1, 30.2, 3.0)] {
            for height in [0.4, -0.4] {
                let points = found(InstructionSet::best(), &blob(x_px, y_px, sigma_px, height));
                assert_eq!(points.len(), 1, "{sigma_px}: {points:?}");
                let point = &points[0];
                let miss = (f64::from(point.x) + 0.5 - x_px).hypot(f64::from(point.y) + 0.5 - y_px);
                assert!(miss < 0.05, "{sigma_px}: {miss}");
                // This image lacks the assumed camera blur of 0.5 px. The difference of layers s and 2^(1/3) s of a
                // blob b is greatest at s = 2^(-1/6) b.
                let expected = sigma_px / 2_f64.powf(1.0 / 6.0);
                let ratio = f64::from(point.sigma) / expected;
                assert!((ratio - 1.0).abs() < 0.1, "{sigma_px}: {ratio}");
            }
        }
    }

    #[test]
    fn a_faint_blob_an_edge_and_a_plain_give_nothing() {
        assert!(found(InstructionSet::best(), &blob(40.5, 30.5, 2.5, 0.01)).is_empty());
        let mut edge = blob(40.5, 30.5, 2.5, 0.0);
        assert!(found(InstructionSet::best(), &edge).is_empty());
        edge.pixels
            .iter_mut()
            .enumerate()
            .for_each(|(index, pixel)| *pixel = if index % 80 < 37 { 0.1 } else { 0.9 });
        assert!(found(InstructionSet::best(), &edge).is_empty());
    }

    /// Squares of random grey in four sizes.
    fn squares() -> Gray {
        let mut rng = marf_numeric::Rng::new(5);
        let grey: Vec<f32> = (0..4 * 91 * 70).map(|_| 0.25 * rng.unit_f64() as f32).collect();
        let pixel = |index: usize| {
            let (x, y) = (index % 91, index / 91);
            (0..4)
                .map(|size| grey[size * 91 * 70 + (y >> size) * 91 + (x >> size)])
                .sum()
        };
        Gray {
            width: 91,
            height: 70,
            pixels: (0..91 * 70).map(pixel).collect(),
        }
    }

    #[test]
    fn candidates_are_those_of_the_definition_on_every_set() {
        let mut scale_space = ScaleSpace::new(InstructionSet::best(), &squares(), FirstOctave::Native);
        scale_space.fill(InstructionSet::best());
        let (volume, threshold) = (
            DogVolume {
                scale_space: &scale_space,
            },
            0.004,
        );
        let inner = (1..69).flat_map(|y| (0..3).flat_map(move |layer| (1..90).map(move |x| [layer, y, x])));
        let beyond = inner.filter(|&cell| volume.at(cell, [0; 3]).abs() > f64::from(threshold));
        let expected: Vec<[usize; 3]> = beyond.filter(|&cell| volume.is_strict(cell)).collect();
        assert!(expected.len() > 8, "{}", expected.len());
        for set in InstructionSet::all() {
            let scale_space = &scale_space;
            assert_eq!(
                simd::run(
                    set,
                    CandidateScan {
                        scale_space,
                        threshold
                    }
                ),
                expected,
                "{set:?}"
            );
        }
    }

    #[test]
    fn points_are_equal_to_the_bit_on_every_set() {
        let plain = found(InstructionSet::all()[0], &squares());
        assert!(plain.len() > 8, "{}", plain.len());
        assert!(plain.is_sorted_by_key(|point| point.cell));
        assert!(
            InstructionSet::all()
                .into_iter()
                .all(|set| found(set, &squares()) == plain)
        );
    }
}
